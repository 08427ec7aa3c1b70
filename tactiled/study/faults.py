"""Faults: frames that go wrong in one way, by so much, what restoration is told of it, and the truth."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from tactiled.frames import DEAD, MISSING, SATURATED
from tactiled.runtime.pipeline import NOISE_FRAMES
from tactiled.simulate.array import FINER
from tactiled.study.skin import Floats, Frames, Skin, covered, doubled, drawn, means, mistaken, pressed
from tactiled.study.truth import PEAK

NOISE = 0.01  # of the frame's peak, where it is not what is swept
CORRELATION = 1.5  # pitches, of correlated noise
WANDER = 8  # frames, and a quarter of the array, over which a drift stays what it is
MESSAGE = 5  # taxels: of 12 bits in a classic CAN message
Flags = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Setting:
    """What all sweeps share."""

    skin: Skin
    seed: int
    scenes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One frame that goes wrong, what restoration is told of it, and the truth."""

    scene: str
    skin: Skin  # as believed; its surface is what blurred
    frame: Frames
    truth: Floats
    noise: float  # kPa, as told
    flags: Flags | None = None
    floor: float = 0.0  # kPa, what rounding alone makes of the noise
    before: Frames | None = None  # frames (T, ...) that a method sees before it
    still: Frames | None = None  # frames (T, ...) that the noise is measured from; None where it is as told


def scenes(skin: Skin, setting: Setting) -> Iterator[tuple[str, Floats, Floats, np.random.Generator]]:
    """Every touching scene's clean frame and truth, and random numbers for what goes wrong."""
    for number, scene in enumerate(setting.scenes):
        fine = drawn(skin, scene, setting.seed)
        clean, truth = skin.surface.sense(fine).reshape(skin.array.frame_shape), means(skin, fine)
        if not pressed(truth[None]):
            continue
        yield scene, clean, truth, np.random.default_rng([setting.seed, number, 2])


def noisy(clean: Floats, noise: float, random: np.random.Generator) -> tuple[Frames, float]:
    """A frame with white noise, over its peak, and that noise in kPa."""
    sigma = noise * float(clean.max())
    return (clean + random.normal(0, sigma, clean.shape)).astype(np.float32), sigma


def _plain(skin: Skin, setting: Setting, noise: float = NOISE) -> Iterator[Case]:
    for scene, clean, truth, random in scenes(skin, setting):
        frame, sigma = noisy(clean, noise, random)
        yield Case(scene, skin, frame, truth, sigma)


def cover(value: float, setting: Setting) -> Iterator[Case]:
    """Thickness over pitch."""
    return _plain(covered(setting.skin, value), setting)


def white(value: float, setting: Setting) -> Iterator[Case]:
    """Noise, % of the peak."""
    return _plain(setting.skin, setting, value / 100)


def correlated(value: float, setting: Setting) -> Iterator[Case]:
    """Noise that neighbours share, % of the peak, its true strength told."""
    skin = setting.skin
    for scene, clean, truth, random in scenes(skin, setting):
        smooth = gaussian_filter(random.normal(0, 1, clean.shape), CORRELATION, mode="wrap")
        sigma = value / 100 * float(clean.max())
        yield Case(scene, skin, (clean + sigma * smooth / smooth.std()).astype(np.float32), truth, sigma)


def rowwise(value: float, setting: Setting) -> Iterator[Case]:
    """An error that all of a row share, % of the peak, over a little white noise; its true strength told."""
    skin = setting.skin
    for scene, clean, truth, random in scenes(skin, setting):
        frame, sigma = noisy(clean, 0.002, random)
        rows = value / 100 * float(clean.max()) * random.normal(0, 1, (len(clean), 1))
        told = float(np.hypot(sigma, value / 100 * clean.max()))
        yield Case(scene, skin, (frame + rows).astype(np.float32), truth, told)


def offset(value: float, setting: Setting) -> Iterator[Case]:
    """An offset of all taxels, % of the peak, that nobody told of."""
    for case in _plain(setting.skin, setting):
        lift = np.float32(value / 100 * case.noise / NOISE)
        yield Case(case.scene, case.skin, case.frame + lift, case.truth, case.noise)


def drift(value: float, setting: Setting) -> Iterator[Case]:
    """An offset that wanders over array and time, % of the peak; only the white noise is told."""
    skin = setting.skin
    for scene, clean, truth, random in scenes(skin, setting):
        wide = (WANDER, *(n / 4 for n in clean.shape))
        field = gaussian_filter(random.normal(0, 1, (3 * WANDER, *clean.shape)), wide, mode="wrap")
        peak = float(clean.max())
        white = random.normal(0, NOISE * peak, field.shape)
        film = (clean + value / 100 * peak * field / field.std() + white).astype(np.float32)
        yield Case(scene, skin, film[-1], truth, NOISE * peak, before=film[:-1])


def misjudged(value: float, setting: Setting) -> Iterator[Case]:
    """True noise over the noise told; the service measures it from frames in which nothing moves."""
    skin = setting.skin
    for scene, clean, truth, random in scenes(skin, setting):
        frame, sigma = noisy(clean, NOISE, random)
        still = (clean + random.normal(0, sigma, (NOISE_FRAMES, *clean.shape))).astype(np.float32)
        yield Case(scene, skin, frame, truth, sigma / value, still=still)


def _wrong(setting: Setting, **factors: float) -> Iterator[Case]:
    return _plain(mistaken(setting.skin, **factors), setting)


def thickness(value: float, setting: Setting) -> Iterator[Case]:
    """True thickness, % over the one believed."""
    return _wrong(setting, thickness=1 + value / 100)


def young(value: float, setting: Setting) -> Iterator[Case]:
    """True modulus of the cover, % over the one believed."""
    return _wrong(setting, young=1 + value / 100)


def poisson(value: float, setting: Setting) -> Iterator[Case]:
    """True Poisson's ratio of the cover, % over the one believed, below a half."""
    return _wrong(setting, poisson=1 + value / 100)


def _dead(value: float, setting: Setting, flagged: bool) -> Iterator[Case]:
    for case in _plain(setting.skin, setting):
        order = np.random.default_rng([setting.seed, 3]).permutation(case.frame.size)
        gone = (order < round(value / 100 * case.frame.size)).reshape(case.frame.shape)
        flags = np.where(gone, DEAD, 0).astype(np.uint8) if flagged else None
        yield Case(case.scene, case.skin, np.where(gone, np.float32(0), case.frame), case.truth, case.noise, flags)


def dead(value: float, setting: Setting) -> Iterator[Case]:
    """Share of dead taxels, %, that read 0 and are flagged."""
    return _dead(value, setting, True)


def dead_untold(value: float, setting: Setting) -> Iterator[Case]:
    """Share of dead taxels, %, that read 0 and nobody told of."""
    return _dead(value, setting, False)


def lost(value: float, setting: Setting) -> Iterator[Case]:
    """Share of CAN messages that did not come, %."""
    for case in _plain(setting.skin, setting):
        count = -(-case.frame.size // MESSAGE)
        order = np.random.default_rng([setting.seed, 4]).permutation(count)
        gone = np.repeat(order < round(value / 100 * count), MESSAGE)[: case.frame.size].reshape(case.frame.shape)
        flags = np.where(gone, MISSING, 0).astype(np.uint8)
        yield Case(case.scene, case.skin, np.where(gone, np.float32(0), case.frame), case.truth, case.noise, flags)


def _saturated(value: float, setting: Setting, flagged: bool) -> Iterator[Case]:
    for case in _plain(setting.skin, setting):
        ceiling = np.float32(value / 100 * case.noise / NOISE)
        flags = np.where(case.frame >= ceiling, SATURATED, 0).astype(np.uint8) if flagged else None
        yield Case(case.scene, case.skin, np.minimum(case.frame, ceiling), case.truth, case.noise, flags)


def saturated(value: float, setting: Setting) -> Iterator[Case]:
    """Ceiling of the taxels, % of the peak; those at it are flagged."""
    return _saturated(value, setting, True)


def saturated_untold(value: float, setting: Setting) -> Iterator[Case]:
    """Ceiling of the taxels, % of the peak, that nobody told of."""
    return _saturated(value, setting, False)


CONTACTS: dict[str, Callable[[Floats, Floats], Floats]] = {
    "disc": lambda x, y: PEAK * np.clip(FINER * (3 - np.hypot(x, y)) + 0.5, 0, 1),
    "blob": lambda x, y: PEAK * np.exp(-(x**2 + y**2) / (2 * 2.5**2)),
    "bar": lambda x, y: PEAK * np.clip(FINER * (1 - np.abs(y)) + 0.5, 0, 1) * (np.abs(x) < 6),
}


def edge(value: float, setting: Setting) -> Iterator[Case]:
    """How far a contact's middle is past the array's edge, pitches; what lies outside presses as well."""
    skin, wide = setting.skin, doubled(setting.skin)
    rows, columns = skin.array.frame_shape
    inside = slice(rows // 2, rows // 2 + rows), slice(columns // 2, columns // 2 + columns)
    x, y = wide.surface.x / skin.array.pitch, wide.surface.y / skin.array.pitch
    for number, (name, draw) in enumerate(CONTACTS.items()):
        fine, whole = draw(x - columns / 2 - value, y), draw(x, y)
        clean = wide.surface.sense(fine).reshape(wide.array.frame_shape)[inside]
        sigma = NOISE * float(wide.surface.sense(whole).max())
        random = np.random.default_rng([setting.seed, number, 5])
        frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
        yield Case(name, skin, frame, means(wide, fine)[inside], sigma)


def bits(value: float, setting: Setting) -> Iterator[Case]:
    """Bits of a taxel over a full scale of 1.25 peaks; the step is known."""
    for case in _plain(setting.skin, setting, 0.001):
        step = 1.25 * case.noise / 0.001 / 2**value
        frame = (np.round(case.frame / step) * step).astype(np.float32)
        floor = step / 12**0.5
        told = float(np.hypot(case.noise, floor))
        yield Case(case.scene, case.skin, frame, case.truth, told, floor=floor)


def jitter(value: float, setting: Setting) -> Iterator[Case]:
    """Taxels out of place, standard deviation along x and y in % of the pitch."""
    skin = setting.skin
    random = np.random.default_rng([setting.seed, 6])
    rows, columns = skin.array.frame_shape
    places = np.mgrid[:rows, :columns] + random.normal(0, value / 100, (2, rows, columns))
    for scene, _, truth, own in scenes(skin, setting):
        between = _between(skin, scene, setting.seed)
        frame, sigma = noisy(map_coordinates(between, places * FINER, order=3, mode="nearest"), NOISE, own)
        yield Case(scene, skin, frame, truth, sigma)


def _between(skin: Skin, scene: str, seed: int) -> Floats:
    """What taxels would sense a `FINER`th of the pitch apart."""
    rows, columns = skin.array.frame_shape
    found = np.empty((rows * FINER, columns * FINER))
    fine = drawn(skin, scene, seed)
    for down in range(FINER):
        for along in range(FINER):
            moved = np.roll(fine, (-down, -along), axis=(0, 1))
            if down:
                moved[-down:] = 0
            if along:
                moved[:, -along:] = 0
            found[down::FINER, along::FINER] = skin.surface.sense(moved).reshape(rows, columns)
    return found
