"""The table of methods, and the restorer that keeps each of them from harm."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ConfigError
from tactiled.restore.auto import POINTS, Auto
from tactiled.restore.blur import Blur
from tactiled.restore.inpaint import Gaps
from tactiled.restore.modes import Floats, Image
from tactiled.restore.noise import HUGE
from tactiled.restore.nonnegative import Nonneg
from tactiled.restore.points import Point, Points
from tactiled.restore.richardson_lucy import Lucy
from tactiled.restore.scene import Restored, Scene
from tactiled.restore.total_variation import Variation
from tactiled.restore.wiener import Wiener, deviation, untouched
from tactiled.restore.window import Windowed, fits

Run = Callable[[Image], Restored]

LUCY = 30  # iterations of Richardson-Lucy, at most
FAST = 24  # of the accelerated: 30 are 1 % better at 16 squared, and take over five times the median at times
ASKED = "selected by hand"
TOO_MANY = "not a few point loads; used NNLS"
NO_AREA = "total variation needs neighbours in a grid: non-negative instead"


class Restorer:
    """Turns frames of one array into surface pressure by one method; remembers the frame before, until `reset`."""

    def __init__(self, method: str, blur: Blur, noise_kpa: float) -> None:
        self._scene = Scene(blur, noise_kpa)
        self._gaps = Gaps(blur.modes)
        self._method = METHODS[method](self._scene)
        self._run = self._method.run
        self._image: Image | None = None  # the last

    def __call__(self, frame: NDArray[np.float32], flags: NDArray[np.uint8] | None = None) -> Restored:
        """Restore a frame (kPa, the taxels' shape; NaN and flagged taxels are unknown); never gives NaN."""
        y = np.ascontiguousarray(frame, np.float32)
        scene = self._scene
        scene.high, scene.low = y.item(y.argmax()), y.item(y.argmin())
        if not (scene.high < HUGE and scene.low > -HUGE) or (flags is not None and flags.any()):
            y = self._gaps.mask(y, flags)
            scene.high, scene.low = y.item(y.argmax()), y.item(y.argmin())
            if not self._method.rests(y):
                y = self._gaps.fill()
                scene.high, scene.low = y.item(y.argmax()), y.item(y.argmin())
        done = self._run(y)
        self._image = done.image
        return done

    def prepare(self) -> None:
        """Make now what any frame may need, so that none has to wait for it."""
        self._method.prepare()

    def reset(self) -> None:
        """Forget the frames so far."""
        self._method.forget()

    @property
    def points(self) -> tuple[Point, ...]:
        """Loads (mm from the first taxel, N) that make up the image last restored; none if it is no few points."""
        return self._method.points.found if self._method.points else ()

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored."""
        return self._method.spread() if self._method.spread else deviation(self._scene, self._image)


def require(name: str) -> None:
    """ConfigError where there is no method of that name."""
    if name not in METHODS:
        raise ConfigError(f"method = {name!r}: no such method: choose one of {', '.join(METHODS)}")


def make(name: str, blur: Blur, noise_kpa: float) -> Restorer:
    """Make the restorer of a method in METHODS for a taxel noise (kPa); ConfigError for any other."""
    require(name)
    if not (np.isfinite(noise_kpa) and noise_kpa > 0):
        raise ConfigError(f"noise = {noise_kpa} kPa: give a taxel's standard deviation, above 0")
    return Restorer(name, blur, float(noise_kpa))


class Method(NamedTuple):
    """What a name in METHODS stands for."""

    run: Run
    forget: Callable[[], None] = lambda: None
    prepare: Callable[[], None] = lambda: None
    rests: Callable[[Image], bool] = lambda _: False  # whether a frame needs none of its gaps filled
    points: Points | Windowed | None = None  # what fits them
    spread: Callable[[], Floats] | None = None  # deviation of an image that is not the linear one


def _raw(scene: Scene) -> Method:
    repeat = [n // m for n, m in zip(scene.blur.surface_shape, scene.blur.frame_shape, strict=True)]
    image, wiener = np.empty(scene.blur.surface_shape, np.float32), Wiener(scene)
    cells = image.reshape([each for m, k in zip(scene.blur.frame_shape, repeat, strict=True) for each in (m, k)])

    def run(y: Image) -> Restored:
        scene.look(y)
        cells[...] = y.reshape([each for m in y.shape for each in (m, 1)])
        return Restored(image, "raw", ASKED, 0, 1.0, scene.resolution())

    return Method(run, spread=lambda: untouched(scene, wiener))


def _wiener(scene: Scene) -> Method:
    wiener = Wiener(scene)

    def run(y: Image) -> Restored:
        scene.look(y)
        image = wiener()
        chosen = wiener.chosen
        return Restored(image, "wiener", ASKED, 0, chosen.noise_gain, chosen.resolution_mm)

    return Method(run, prepare=partial(scene.ahead, wiener.prepare))


def _lucy(scene: Scene, accelerate: bool = False) -> Method:
    lucy, wiener = Lucy(scene, FAST if accelerate else LUCY, accelerate), Wiener(scene)
    name = "rl-fast" if accelerate else "rl"

    def run(y: Image) -> Restored:
        scene.look(y)
        done = lucy(y)
        return Restored(lucy.image, name, ASKED, done, wiener.filter.noise_gain, scene.resolution())

    return Method(run, prepare=partial(scene.ahead, wiener.prepare))


def _nonneg(scene: Scene, solver: Nonneg | None = None, name: str = "nnls", why: str = ASKED) -> Method:
    nonneg, wiener = solver or Nonneg(scene), Wiener(scene)

    def run(y: Image) -> Restored:
        scene.look(y)
        done = nonneg(wiener)
        gain = nonneg.noise_gain(wiener.filter.noise_gain)
        return Restored(nonneg.image, name, why, done, gain, scene.resolution())

    return Method(run, nonneg.reset, partial(scene.ahead, wiener.prepare, nonneg.prepare))


def _variation(scene: Scene) -> Method:
    if len(scene.blur.surface_shape) == 1:
        return _nonneg(scene, why=NO_AREA)
    return _nonneg(scene, Variation(scene), "tv")


def _points(scene: Scene) -> Method:
    nonneg, wiener, points = Nonneg(scene), Wiener(scene), Points(scene)

    def run(y: Image) -> Restored:
        scene.look(y)
        done = nonneg(wiener)
        steps = points(y, nonneg.image)
        if steps:
            drawn = points.drawing
            return Restored(drawn.image, "points", POINTS, done + steps, drawn.noise_gain, scene.resolution())
        gain = nonneg.noise_gain(wiener.filter.noise_gain)
        return Restored(nonneg.image, "nnls", points.never or TOO_MANY, done, gain, scene.resolution())

    def forget() -> None:
        nonneg.reset()
        points.reset()

    def spread() -> Floats:
        return points.drawing.deviation() if points.found else deviation(scene, nonneg.image)

    prepare = partial(scene.ahead, wiener.prepare, nonneg.prepare)
    return Method(run, forget, prepare, points=points, spread=spread)


def _auto(scene: Scene) -> Method:
    auto = Auto(scene)
    if not fits(scene.blur):
        return Method(auto, auto.reset, auto.prepare, auto.rests, auto.points, auto.deviation)
    windowed = Windowed(auto, scene)
    return Method(windowed, windowed.reset, windowed.prepare, auto.rests, windowed, windowed.deviation)


METHODS: dict[str, Callable[[Scene], Method]] = {
    "auto": _auto,
    "raw": _raw,
    "wiener": _wiener,
    "rl": _lucy,
    "rl-fast": lambda scene: _lucy(scene, accelerate=True),
    "nnls": _nonneg,
    "tv": _variation,
    "points": _points,
}
