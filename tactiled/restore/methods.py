"""The table of methods, and the restorer that keeps each of them from harm."""

from collections.abc import Callable
from functools import partial
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32
from tactiled.errors import ConfigError
from tactiled.restore import learned
from tactiled.restore.auto import IDLE, LOADS, Auto
from tactiled.restore.blur import Blur
from tactiled.restore.deviation import deviation, raw_deviation
from tactiled.restore.inpaint import Inpainter
from tactiled.restore.noise import IMPLAUSIBLE_KPA
from tactiled.restore.nonnegative import Nonnegative
from tactiled.restore.points import Points
from tactiled.restore.richardson_lucy import RichardsonLucy
from tactiled.restore.scene import Restored, Scene, never, pressed_noise_gain
from tactiled.restore.total_variation import TotalVariation
from tactiled.restore.wiener import Wiener

RL_ITERATIONS = 30  # of Richardson-Lucy, at most
BY_HAND = "selected by hand"
NO_DATA = "no taxel has data, and nothing is known"
IDLE_IN_PART = f"{IDLE} where taxels have data"
NO_POINTS = "not a few point loads; used NNLS"
NOT_TRAINED = "the network was not trained for this cover, or so many cells: restored by nnls"


class Restorer:
    """Turns frames of one array into surface pressure by one method; no frame matters to the next."""

    def __init__(self, method: str, blur: Blur, noise_kpa: float, noise_ratio: Floats | None = None) -> None:
        self._scene = Scene(blur, noise_kpa)
        self._inpainter = Inpainter(self._scene)
        self.weigh = self._inpainter.weigh
        self.weigh(noise_ratio)
        self._method = METHODS[method](self._scene)
        self.prepare = self._method.prepare
        nothing = np.zeros(self._scene.blur.surface_shape, np.float32)
        self._no_data = Restored(nothing, "idle", NO_DATA, 0, 0.0, self._scene.widest_mm)
        self._shape = blur.surface_shape
        self.surface = nothing  # restored last, with what lies beyond the array where the method has it
        self._empty = self._filled = False  # the last frame
        self._knows_unfelt = False  # the last image's deviation

    def __call__(
        self,
        frame: NDArray[np.float32],
        flags: NDArray[np.uint8] | None = None,
        expired: Callable[[], bool] = never,
    ) -> Restored:
        """Restore a frame (kPa, the taxels' shape; NaN and flagged taxels are unknown); never gives NaN.

        Once `expired` says so, the image is the best so far, and `cut_short`.
        """
        y, scene, self._filled = np.ascontiguousarray(frame, np.float32), self._scene, False
        self._empty = False
        scene.measure_range(y)
        has_gaps = isnan(scene.high)
        plausible = scene.high < IMPLAUSIBLE_KPA and scene.low > -IMPLAUSIBLE_KPA
        if not plausible or self._inpainter.weighs or (flags is not None and flags.any()):
            y = self._inpainter.mask(y, flags)
            if self._inpainter.is_empty():
                self._empty = True
                return self._own(self._no_data)
            scene.measure_range(y)
            if not self._method.is_idle(y):
                y, self._filled = self._inpainter.fill(), True
                scene.measure_range(y)
        scene.expired, scene.cut_short = expired, False
        done = self._own(self._method(y))
        if done.why == IDLE and has_gaps:
            done = done._replace(why=IDLE_IN_PART)
        return done._replace(cut_short=True) if scene.cut_short else done

    def _own(self, done: Restored) -> Restored:
        """Give what was restored without what lies beyond the array."""
        self.surface, self._knows_unfelt = done.image, done.method == learned.Learned.name
        if done.image.shape == self._shape:
            return done
        return Restored(self._scene.inside(done.image), *done[1:])

    def predicted(self) -> Floats32:
        """Give what the taxels (kPa, their shape) feel of what was restored last, beyond the array too."""
        array, last = self._scene.array, self.surface
        if array.wide is None or last.shape == self._shape:
            return array.forward(last)
        return np.asarray(array.wide.forward(last).reshape(array.frame_shape))

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored; NaN if no taxel had data."""
        return self._scene.inside(self.whole()[1])

    def whole(self) -> tuple[Floats32, Floats]:
        """Give the image last restored with what lies beyond the array, and its deviation (kPa).

        Both are NaN beyond if the method leaves that open, the deviation all over if no taxel had data.
        """
        scene, image = self._scene, self._on_surface(self.surface)
        if self._empty:
            return image, np.full(image.shape, np.nan)
        spread = self._method.deviation()
        unfelt = self._inpainter.deviation() if self._filled else scene.unfelt(scene.spectrum)
        if self._knows_unfelt:  # beyond the array and between taxels, not of those that are inferred
            unfelt = np.sqrt(np.maximum(unfelt**2 - scene.unfelt(scene.spectrum) ** 2, 0))
        return image, np.asarray(np.hypot(self._on_surface(spread), unfelt), float)

    def _on_surface(self, values: NDArray[Any]) -> NDArray[Any]:
        """Give values of the surface, or of the array alone: then NaN beyond."""
        if values.shape == self._scene.blur.surface_shape:
            return values
        whole = np.full(self._scene.blur.surface_shape, np.nan, values.dtype)
        self._scene.inside(whole)[...] = values
        return whole


def named(name: str) -> str:
    """Give the name in METHODS of a method, by that or by an older one; ConfigError where there is none."""
    if (now := OLD_NAMES.get(name, name)) not in METHODS:
        raise ConfigError(f"method = {name!r}: no such method: choose one of {', '.join(METHODS)}")
    return now


def make(name: str, blur: Blur, noise_kpa: float, noise_ratio: Floats | None = None) -> Restorer:
    """Make the restorer of a method in METHODS, else ConfigError; `noise_ratio` (N,) is as of `weigh`."""
    name = named(name)
    if not (np.isfinite(noise_kpa) and noise_kpa > 0):
        raise ConfigError(f"noise = {noise_kpa}: give a taxel's standard deviation, above 0")
    return Restorer(name, blur, float(noise_kpa), noise_ratio)


class Linear:
    """Wiener's filter, and what other methods share with it."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._wiener = scene, Wiener(scene)
        self._image: Floats32 | None = None  # the last

    def __call__(self, y: Floats32) -> Restored:
        """Restore a frame without gaps."""
        self._scene.look(y)
        image = self._wiener()
        return self._done(image, "wiener", 0, self._wiener.noise_gain)

    def _done(self, image: Floats32, name: str, iterations: int, gain: float, why: str = BY_HAND) -> Restored:
        self._image = image
        return Restored(image, name, why, iterations, gain, self._scene.resolution())

    def prepare(self) -> None:
        """Make now what any frame may need, so that none has to wait for it."""
        self._scene.prepare(self._wiener.filter)

    def is_idle(self, y: Floats32) -> bool:
        """Whether a frame is noise and nothing else, so that its gaps need not be filled."""
        del y
        return False

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored."""
        return deviation(self._scene, self._image)


class _Raw(Linear):
    def __call__(self, y: Floats32) -> Restored:
        self._scene.look(y)
        return self._done(self._scene.raw(), "raw", 0, 1.0)

    def prepare(self) -> None:
        """Nothing is needed."""

    def deviation(self) -> Floats:
        return raw_deviation(self._scene, self._wiener)


class _RichardsonLucy(Linear):
    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._solver = RichardsonLucy(scene, RL_ITERATIONS)

    def __call__(self, y: Floats32) -> Restored:
        self._scene.look(y)
        done = self._solver(self._scene.frame)
        return self._done(self._solver.image, "rl", done, self._wiener.filter().noise_gain)


class _Nonnegative(Linear):
    def __init__(self, scene: Scene, name: str = "nnls", why: str = BY_HAND) -> None:
        super().__init__(scene)
        self._name, self._why = name, why
        self._solver: learned.Learned | TotalVariation | Nonnegative = Nonnegative(scene)
        if name == "tv":
            self._solver = TotalVariation(scene)
        elif name == "learned":
            self._solver = learned.Learned(scene, self._wiener)

    def __call__(self, y: Floats32) -> Restored:
        self._scene.look(y)
        done = self._solver(self._wiener())
        gain = pressed_noise_gain(self._scene.inside(self._solver.image), self._wiener.noise_gain)
        return self._done(self._solver.image, self._name, done, gain, self._why)

    def prepare(self) -> None:
        self._scene.prepare(self._wiener.filter, self._solver.prepare)

    def deviation(self) -> Floats:
        if isinstance(self._solver, learned.Learned):
            return self._solver.deviation()
        return super().deviation()


def _learned(scene: Scene) -> Linear:
    return _Nonnegative(scene, "learned") if learned.fits(scene.blur) else _Nonnegative(scene, why=NOT_TRAINED)


class _Points(_Nonnegative):
    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._points = Points(scene)

    def __call__(self, y: Floats32) -> Restored:
        done, drawing = super().__call__(y), self._points.drawing
        steps = self._points(y, self._scene.inside(done.image))
        if steps and self._points.loads:
            why = LOADS.format(len(self._points.loads.force))
            return self._done(drawing.image, "points", done.iterations + steps, drawing.noise_gain, why)
        return done._replace(why=self._points.unavailable or NO_POINTS)

    def deviation(self) -> Floats:
        return self._points.drawing.deviation() if self._points.loads else super().deviation()


METHODS: dict[str, Callable[[Scene], Linear | Auto]] = {
    "auto": Auto,
    "raw": _Raw,
    "wiener": Linear,
    "rl": _RichardsonLucy,
    "nnls": _Nonnegative,
    "tv": partial(_Nonnegative, name="tv"),
    "points": _Points,
    "learned": _learned,
}
OLD_NAMES = {"rl-fast": "rl"}  # that configurations, clients and recordings of earlier releases have
