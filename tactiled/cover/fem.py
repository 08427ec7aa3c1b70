"""The gain of a cover by axisymmetric finite elements, refined until an error estimate meets the accuracy.

A smooth footprint presses on the axis of a disc of radius R whose rim slides without friction. At frequencies q
with J1(2 pi q R) = 0 a wave of an endless cover has no slope at the rim. So there the disc has exactly the gain of
the endless cover: no far field is cut, and R only sets how densely low frequencies are sampled.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from tactiled.arrays import Floats
from tactiled.cover import elements, line
from tactiled.cover.stack import Profile, Stack
from tactiled.errors import PhysicsError

# Chosen on random stacks against the exact gain: `python -m tests.bench cover`.
FLOOR = 1e-3  # the accuracy holds up to where the gain stays under this
FOOTPRINT = 0.25  # radius of the footprint, times the frequency where the gain ends
CORE = 0.75  # radius of the mesh's even core, times that frequency
COARSEST = 0.5  # size of an element, over its distance from the core's far side
# That size outwards and downwards, from level to level finer.
LEVELS = [(COARSEST * 2**-step, COARSEST * 2 ** (-step / 2)) for step in np.arange(0, 5.1, 0.5)]
MIN_ELEMENTS = 0.5  # through a layer, over the growth
START_RADIUS = 10.0  # of the disc, over the stack's thickness
MAX_RADIUS = 1e5  # of the disc, over the stack's thickness
LOWEST_LOSS = 0.004  # the largest loss of gain at the disc's lowest frequency
COARSE_ACCURACY = 5e-3  # of a coarse mesh
LOW_FREQUENCIES = 17  # that tell whether the disc samples the low end closely enough
SAMPLES_PER_DECADE = 48
MIN_ACCURACY = 1e-6  # the interpolation between frequencies is no better
STRESS_PLACES = 301  # where the stress under a footprint is given
MAX_UNKNOWNS = 120_000  # take seconds, and a gigabyte
MAX_WAVES = 1e5  # across the disc: the transform of so many takes seconds

Late = Callable[[], bool]  # whether time is up


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The elements' gain, as plain arrays."""

    q: Floats  # (n,) cycles/mm, 0 first
    gain: Floats  # (n,), to a little past where it stays under FLOOR
    error_estimate: float
    mesh: tuple[int, int]  # elements along r and along z
    unknowns: int


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """What a footprint leaves at the sensing plane."""

    r: Floats  # (n,) mm from its middle, 0 first
    stress: Floats  # (n,) over the footprint's pressure
    error_estimate: float


def interpolant(q: Floats, gain: Floats) -> Callable[[Floats], Floats]:
    """Give G between its samples: a cubic spline, even about 0, its knots in proportion to q far out."""
    place = np.arcsinh(q / q[1])
    spline = CubicSpline([-place[1], *place], [gain[1], *gain])
    return lambda at: np.asarray(spline(np.arcsinh(at / q[1])))


def solve(
    stack: Stack, accuracy: float = 1e-3, profile: Profile | None = None, late: Late = lambda: False
) -> Solution:
    """Refine until the estimated error of G is within `accuracy` wherever G is FLOOR or more.

    PhysicsError where `late` or the number of unknowns forbids the accuracy.
    """
    end, reach = _survey(stack, profile, accuracy, late)
    q = _frequencies(reach, end)

    def gain(mesh: elements.Mesh) -> Floats:
        return _gain(stack, mesh, FOOTPRINT / end, q)

    def error(gain: Floats, before: Floats) -> float:
        inside = q <= _last(q, gain, FLOOR)
        return float(np.abs(gain - before)[inside].max()) + _interpolation_error(q[inside], gain[inside])

    meshes = (_mesh(stack, profile, reach, CORE / end, *growths) for growths in LEVELS)
    solved, mesh, estimate = _refined(meshes, gain, error, "gain", accuracy, late)
    return Solution(q, solved, estimate, mesh.shape, mesh.unknowns)


def pressed(
    stack: Stack, radius: float, accuracy: float = 1e-3, profile: Profile | None = None, late: Late = lambda: False
) -> Press:
    """Give the stress under even pressure on a disc of `radius` (mm), to `accuracy` of that pressure.

    Under a profile no gain can tell it: what a load leaves there depends on where it presses.
    """
    if not 0 < radius < np.inf:
        raise PhysicsError(f"footprint radius is {radius} mm: give a finite number above 0")
    bent = _with_corner(profile, radius)
    end, reach = _survey(stack, bent, accuracy, late)
    r = np.linspace(0, 2 * radius + 3 * stack.depth, STRESS_PLACES)

    def stress(mesh: elements.Mesh) -> Floats:
        pressure = np.asarray(line.points(mesh.r)[0] < radius, float)
        force = elements.sensed(stack, mesh, line.forces(mesh.r, pressure))
        return line.between(mesh.r, line.recover(mesh.r, force), r)

    def error(stress: Floats, before: Floats) -> float:
        return float(np.abs(stress - before).max())

    meshes = (_mesh(stack, bent, reach, CORE / end, *growths) for growths in LEVELS)
    solved, _, estimate = _refined(meshes, stress, error, "stress", accuracy, late)
    return Press(r, solved, estimate)


def _refined(
    meshes: Iterable[elements.Mesh],
    solve: Callable[[elements.Mesh], Floats],
    difference: Callable[[Floats, Floats], float],
    what: str,
    accuracy: float,
    late: Late,
) -> tuple[Floats, elements.Mesh, float]:
    """Give the first solution within `accuracy`, its mesh and error: its difference from the mesh before."""
    before, error = np.asarray(np.inf), np.inf
    for mesh in meshes:
        if mesh.unknowns > MAX_UNKNOWNS:
            break
        solution = solve(mesh)
        error = difference(solution, before)
        if error <= accuracy:
            return solution, mesh, error
        if late():
            estimate = f"the estimate is {error:.1e}" if np.isfinite(error) else "there is no estimate yet"
            raise PhysicsError(
                f"accuracy {accuracy:g} is not met in the given time: {estimate}; allow more time or ask for less"
            )
        before = solution
    raise PhysicsError(
        f"accuracy {accuracy:g} of the {what} cannot be met: the error estimate is {error:.1e}; ask for less"
    )


def _with_corner(profile: Profile | None, radius: float) -> Profile:
    """Give a profile with a corner of the mesh at `radius` (mm)."""
    corners = np.unique([0.0, radius, *(profile.radius if profile else ())])
    rise = np.interp(corners, profile.radius, profile.rise) if profile else np.zeros_like(corners)
    return Profile(tuple(corners.tolist()), tuple(rise.tolist()))


def _survey(stack: Stack, profile: Profile | None, accuracy: float, late: Late) -> tuple[float, float]:
    """Find by coarse meshes the frequency (cycles/mm) where the gain ends and the radius (mm) the disc needs.

    The coarse mesh's own error adds to the gain at high frequencies. So `end` comes down in steps, each with a
    mesh that fits it better.
    """
    if not MIN_ACCURACY <= accuracy < 1:
        raise PhysicsError(f"accuracy is {accuracy}: give {MIN_ACCURACY:g} to less than 1, such as 1e-3")
    depth, extent = _depth(stack, profile), max(stack.faces[-1], profile.radius[-1] if profile else 0.0)
    deepest = end = 2 / depth
    reach = START_RADIUS * extent
    falling = True
    while reach < MAX_RADIUS * extent:
        if reach * end > MAX_WAVES:
            raise PhysicsError(
                f"far field reaches past {reach:.3g} mm, too far for finite elements where stress is sensed "
                f"{depth:g} mm deep: use model 'layered'"
            )
        q = _frequencies(reach, end)
        gain = _gain(stack, _mesh(stack, profile, reach, CORE / end, *LEVELS[0]), FOOTPRINT / end, q)
        last = _last(q, gain, COARSE_ACCURACY)
        low = slice(LOW_FREQUENCIES)
        if abs(1 - gain[1]) > LOWEST_LOSS or _interpolation_error(q[low], gain[low]) > accuracy / 4:
            if late():
                raise PhysicsError(
                    f"accuracy {accuracy:g} is not met in the given time: the far field reaches past "
                    f"{reach:.3g} mm; allow more time"
                )
            reach *= 2
        elif falling and 3 * last < end:
            end = 3 * last
        elif last >= end < deepest:
            end, falling = min(2 * end, deepest), False
        else:
            return min(end, 1.25 * _last(q, gain, FLOOR)), reach
    raise PhysicsError(f"far field reaches past {reach:.3g} mm: bring the layers' moduli closer together")


def _last(q: Floats, gain: Floats, floor: float) -> float:
    """Give the last frequency (cycles/mm) where the gain is above a floor, or a low one."""
    return float(q[max(int(np.flatnonzero(np.abs(gain) > floor)[-1]), LOW_FREQUENCIES // 2)])


def _depth(stack: Stack, profile: Profile | None) -> float:
    """Give the least depth (mm) of the sensing plane under the surface."""
    depth = stack.depth + (min(profile.rise) if profile else 0.0)
    if depth <= stack.depth - stack.layers[0].thickness:
        raise PhysicsError(
            f"profile takes {-min(profile.rise) if profile else 0:g} mm from a cover "
            f"{stack.layers[0].thickness:g} mm thick: take less"
        )
    return depth


def _frequencies(reach: float, end: float) -> Floats:
    """Give 0 and the disc's own frequencies (cycles/mm) to a little past `end`, even in their logarithm."""
    count = max(int(2.6 * reach * end), 16)
    steps = int(SAMPLES_PER_DECADE * np.log10(count / 8)) + 2
    n = np.unique(np.concatenate([np.arange(1, 9), np.geomspace(8, count, steps).astype(int)]))
    return np.concatenate([[0.0], line.standing(n) / (2 * np.pi * reach)])


def _gain(stack: Stack, mesh: elements.Mesh, radius: float, q: Floats) -> Floats:
    """Give the gain (n,) at q (n,) that a mesh gives to a smooth footprint of `radius` (mm)."""
    density = np.exp(-((line.points(mesh.r)[0] / radius) ** 2)) / (np.pi * radius**2)
    pressure = line.forces(mesh.r, density)
    sensed = elements.sensed(stack, mesh, pressure)
    applied, felt = (line.hankel(mesh.r, line.recover(mesh.r, force), q) for force in (pressure, sensed))
    return felt / applied


def _mesh(
    stack: Stack, profile: Profile | None, reach: float, core: float, outwards: float, downwards: float
) -> elements.Mesh:
    """Grade a mesh from the load outwards and downwards, bent to the profile in the top layer.

    Hard skins that bend over foam need many elements outwards but no more downwards, where levels refine by less.
    """
    corners = profile.radius if profile else (0.0,)
    r = np.concatenate(
        [
            [0.0],
            *(_between_both(*ends, core, outwards) for ends in pairwise(corners)),
            _graded(corners[-1], reach, core, outwards, corners[-1]),
        ]
    )
    parts = [_graded(*ends, core, downwards, 0.0) for ends in pairwise(stack.faces)]
    z = np.tile(np.concatenate([[0.0], *parts]), (len(r), 1))
    if profile:
        cover = stack.layers[0].thickness
        rise = np.interp(r, profile.radius, profile.rise)[:, None]
        z -= rise * np.maximum(1 - z / cover, 0)
    return elements.Mesh(r, z, (0, *np.cumsum([len(part) for part in parts]).tolist()))


def _graded(start: float, stop: float, core: float, growth: float, origin: float) -> Floats:
    """Give the ends of elements from `start` to `stop`, each `growth` times as long as it is far from `origin`."""
    first, last = start - origin + core, stop - origin + core
    min_count = int(np.ceil(MIN_ELEMENTS / growth))
    count = max(min_count, int(np.ceil(np.log(last / first) / np.log1p(growth))))
    ends = np.geomspace(first, last, count + 1)[1:] - core + origin
    ends[-1] = stop
    return ends


def _between_both(start: float, stop: float, core: float, growth: float) -> Floats:
    """Grade from both corners of a profile to the middle."""
    half = (stop - start) / 2
    out = _graded(0.0, half, core, growth, 0.0)
    return start + np.concatenate([out, (2 * half - out[:-1])[::-1], [2 * half]])


def _interpolation_error(q: Floats, gain: Floats) -> float:
    """Estimate the error of interpolating the gain, below the lowest frequency and above it.

    Above, it is a quarter of what every other sample makes of the rest.
    """
    missed = np.abs(interpolant(q[::2], gain[::2])(q[1::2]) - gain[1::2]).max() / 4
    return float(missed + abs(1 - gain[1]) / 60)
