"""What lies over and under the sensing plane: layers from the top down to a rigid base."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from tactiled.errors import PhysicsError
from tactiled.units import LENGTH, STIFFNESS


@dataclass(frozen=True, slots=True)
class Layer:
    """One elastic, isotropic layer: thickness (mm), Young's modulus (MPa), Poisson's ratio."""

    thickness: float
    young: float
    poisson: float

    def __post_init__(self) -> None:
        """Refuse what no elastic layer can be."""
        sizes = (("thickness", self.thickness, LENGTH), ("Young's modulus", self.young, STIFFNESS))
        for name, value, unit in sizes:
            if not (np.isfinite(value) and value > 0):
                raise PhysicsError(f"layer {name} is {value} {unit}: give a finite number above 0")
        if not 0 <= self.poisson < 0.5:
            raise PhysicsError(
                f"layer Poisson's ratio is {self.poisson}: give 0 to less than 0.5 (rubber: 0.49 to 0.4999)"
            )

    def __str__(self) -> str:
        """Say it as a designer would."""
        return f"{self.thickness:.4g} mm {self.young:.4g} MPa {self.poisson:.4g}"

    @property
    def shear(self) -> float:
        """Shear modulus mu (MPa)."""
        return self.young / (2 * (1 + self.poisson))

    @property
    def lame(self) -> float:
        """Lamé's first modulus lambda (MPa)."""
        return self.young * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))


@dataclass(frozen=True, slots=True)
class Stack:
    """Layers from the top down on a rigid base, and where among them stress is sensed.

    `sensing` counts the interface from the top: 1 is the underside of the first layer, len(layers) the base.
    `bonds` has one entry an interface, the base included: True bonded, False frictionless; empty is all bonded.
    """

    layers: tuple[Layer, ...]
    sensing: int = 1
    bonds: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        """Fill in the bonds and refuse a sensing plane or bonds that the layers do not have."""
        count = len(self.layers)
        if not count:
            raise PhysicsError("stack has no layer: give at least the cover")
        if not 1 <= self.sensing <= count:
            raise PhysicsError(f"sensing plane is interface {self.sensing}: give 1 to {count} for {count} layers")
        if not self.bonds:
            object.__setattr__(self, "bonds", (True,) * count)
        if len(self.bonds) != count:
            raise PhysicsError(f"{len(self.bonds)} bonds for {count} interfaces: give one each, the base included")

    def __str__(self) -> str:
        """Name the layers from the top down, which of them slide, and a double line where stress is sensed."""
        bonds = zip(self.layers, self.bonds, strict=True)
        names = [f"{layer}{'' if bonded else ' sliding'}" for layer, bonded in bonds]
        above, below = (" | ".join(part) for part in (names[: self.sensing], names[self.sensing :]))
        return f"{above} ‖ {below or 'base'}"

    @property
    def faces(self) -> tuple[float, ...]:
        """Depth (mm) of every interface from the surface (0) to the base."""
        return (0.0, *accumulate(layer.thickness for layer in self.layers))

    @property
    def depth(self) -> float:
        """Depth (mm) of the sensing plane."""
        return self.faces[self.sensing]

    def thickened(self, factor: float) -> "Stack":
        """The stack with every layer over the sensing plane `factor` times as thick."""
        return self.with_cover(lambda layer: replace(layer, thickness=layer.thickness * factor))

    def with_cover(self, change: Callable[[Layer], Layer]) -> "Stack":
        """The stack with every layer over the sensing plane changed."""
        cover, rest = self.layers[: self.sensing], self.layers[self.sensing :]
        return replace(self, layers=(*map(change, cover), *rest))


@dataclass(frozen=True, slots=True)
class Profile:
    """How much thicker than flat the top layer is around a taxel: a boss, a dimple or an edge, round about r = 0.

    `rise` (mm) belongs to `radius` (mm), is linear in between and 0 from the last radius on; below 0 is a dimple.
    """

    radius: tuple[float, ...]
    rise: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse points that make no profile."""
        if len(self.radius) != len(self.rise) or len(self.radius) < 2:
            raise PhysicsError(
                f"profile has {len(self.radius)} radii and {len(self.rise)} rises: give as many, and at least two"
            )
        if not np.isfinite([*self.radius, *self.rise]).all() or self.radius[0] != 0:
            raise PhysicsError(f"profile radii {self.radius}: start at 0 and give finite numbers")
        if (np.diff(self.radius) <= 0).any():
            raise PhysicsError(
                f"profile radii {self.radius}: let them grow (an edge needs a slope, however steep)"
            )
        if self.rise[-1] != 0:
            raise PhysicsError(f"profile ends with a rise of {self.rise[-1]} mm: let it end flat, with 0")
