"""Richardson-Lucy: always positive, one multiplication at a time, stopped before it fits the noise."""

import numpy as np

from tactiled.arrays import Floats32
from tactiled.restore.scene import Scene
from tactiled.restore.solvers import richardson_lucy

OFFSET_SIGMAS = 3.0  # noise standard deviations lifted over 0 first, so that cutting the rest off hardly biases
START = np.float32(0.1)  # of that offset, where the frame has less: what starts at 0 stays there
STOP_VARIANCE = 0.8  # of the noise's: a residual this small is noise alone, part of which is fitted
MIN_REACH = 1e-3  # of a cell's pressure that the taxels feel


class RichardsonLucy:
    """Restores a frame from the frame itself, or from a flat image where cells are finer."""

    def __init__(self, scene: Scene, max_iterations: int) -> None:
        self._scene, self._max_iterations = scene, max_iterations
        modes = scene.modes
        self._gain = np.asarray(modes.gain, np.float32)
        self._to_taxels, self._to_surface = modes.to_taxels(), modes.head_to_surface()
        self._to_taxel_modes, self._to_surface_modes = modes.to_taxel_modes(), modes.to_surface_modes()
        self._surface_modes, self._taxel_modes = self._to_surface_modes.empty(), np.empty_like(scene.c)
        self._Hx, self._back = self._to_taxels.empty(), self._to_surface.empty()
        self._offset = np.float32(OFFSET_SIGMAS * scene.noise)
        reach = self._adjoint(np.ones(scene.blur.frame_shape, np.float32))  # by the modes, as all that it weighs
        self._weight = np.asarray(1 / np.maximum(reach, MIN_REACH), np.float32)
        self.image = np.empty_like(self._back)

    def _forward(self, x: Floats32) -> Floats32:
        self._to_surface_modes(x, self._surface_modes)
        np.multiply(self._surface_modes[self._scene.modes.head], self._gain, out=self._taxel_modes)
        self._to_taxels(self._taxel_modes, self._Hx)
        np.maximum(self._Hx, 0, out=self._Hx)  # smooth pressure swings below it beside an edge
        return np.add(self._Hx, self._offset, out=self._Hx)

    def _adjoint(self, y: Floats32) -> Floats32:
        self._to_taxel_modes(y, self._taxel_modes)
        np.multiply(self._taxel_modes, self._gain, out=self._taxel_modes)
        return self._to_surface(self._taxel_modes, self._back)

    def __call__(self, y: Floats32) -> int:
        """Restore a frame without gaps; gives the iterations made."""
        scene, image = self._scene, self.image
        lifted = np.maximum(y + self._offset, np.float32(1e-3) * self._offset)
        if image.shape == lifted.shape:
            np.maximum(y, START * self._offset, out=image)
        else:
            image[...] = max(float(y.mean()), float(self._offset))
        limit, stop = self._max_iterations, STOP_VARIANCE * scene.noise**2
        done = richardson_lucy(self._forward, self._adjoint, lifted, image, self._weight, limit, stop)
        scale = scene.force_scale(scene.force - float(np.vdot(scene.cell_reach, image)))
        np.multiply(image, np.float32(scale), out=image)
        return done
