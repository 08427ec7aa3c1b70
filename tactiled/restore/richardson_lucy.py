"""Richardson-Lucy: always positive, one multiplication at a time, stopped before it fits the noise."""

import numpy as np

from tactiled.restore.modes import Image
from tactiled.restore.scene import Scene
from tactiled.restore.solvers import richardson_lucy

OFFSET = 3.0  # noise standard deviations lifted over 0 first, so that cutting the rest off hardly biases the force
START = np.float32(0.1)  # of that offset, where the frame has less: what starts at 0 stays there
ENOUGH = 0.8  # of the noise's variance: a residual this small has nothing left but noise, part of which is fitted


class Lucy:
    """Restores a frame by at most `iterations`, from the frame itself, or a flat image where cells are finer."""

    def __init__(self, scene: Scene, iterations: int, accelerate: bool = False) -> None:
        self._scene, self._iterations, self._accelerate = scene, iterations, accelerate
        modes = scene.modes
        self._gain = np.asarray(modes.gain, np.float32)
        self._to_taxels, self._to_surface = modes.to_taxels(), modes.to_surface(seen=True)
        self._analyse = modes.to_taxel_modes()
        self._there = modes.to_surface_modes()
        self._wide, self._narrow = self._there.empty(), np.empty_like(scene.c)
        self._Hx, self._back = self._to_taxels.empty(), self._to_surface.empty()
        self._lift = np.float32(OFFSET * scene.noise)
        felt = self._adjoint(np.ones(scene.blur.frame_shape, np.float32))  # by the modes, as all that it weighs
        self._weight = np.asarray(1 / np.maximum(felt, 1e-3), np.float32)
        self.image = np.empty_like(self._back)

    def _forward(self, x: Image) -> Image:
        self._there(x, self._wide)
        np.multiply(self._wide[self._scene.modes.head], self._gain, out=self._narrow)
        self._to_taxels(self._narrow, self._Hx)
        np.maximum(self._Hx, 0, out=self._Hx)  # smooth pressure swings below it beside an edge
        return np.add(self._Hx, self._lift, out=self._Hx)

    def _adjoint(self, y: Image) -> Image:
        self._analyse(y, self._narrow)
        np.multiply(self._narrow, self._gain, out=self._narrow)
        return self._to_surface(self._narrow, self._back)

    def __call__(self, y: Image) -> int:
        """Restore a frame without gaps; gives the iterations made."""
        lifted = np.maximum(y + self._lift, np.float32(1e-3) * self._lift)
        if self.image.shape == lifted.shape:
            np.maximum(y, START * self._lift, out=self.image)
        else:
            self.image[...] = max(float(y.mean()), float(self._lift))
        enough = ENOUGH * self._scene.noise**2
        done = richardson_lucy(
            self._forward,
            self._adjoint,
            lifted,
            self.image,
            self._weight,
            self._iterations,
            enough,
            self._accelerate,
        )
        predicted = float(np.vdot(self._scene.blur.reach, self.image))
        scale = self._scene.force_scale(self._scene.force - predicted)
        np.multiply(self.image, np.float32(scale), out=self.image)
        return done
