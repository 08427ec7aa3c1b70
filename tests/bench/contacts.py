"""How well contacts are detected in the raw and in the restored image: position, force and smallest gap.

Indenters are flat discs off the taxels' grid, drawn four times finer than it and blurred exactly; restoration has
the finite-element kernel and knows the noise. Lengths in mm at a pitch of 1 mm.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from tactiled.bench.results import machine
from tactiled.bench.scenes import PEAK_KPA
from tactiled.bench.skin import rubber
from tactiled.cli.bench import print_table
from tactiled.contacts.detection import Finder
from tactiled.geometry import raster
from tactiled.restore.methods import make
from tactiled.simulate.array import FINER

SIDE = 24  # taxels along each side
THICKNESSES = (0.5, 1.0, 2.0, 3.0)  # over the pitch
NOISES = (0.002, 0.01, 0.05)  # of the frame's peak
RADIUS_MM = (1.0, 2.5)  # of single discs
PAIR_RADIUS_MM = 1.0
RING_RADIUS_MM, RING_WIDTH_MM, RINGS_OFF_MM = (3.0, 8.0), (1.0, 2.0), 2.0
GAPS_MM = np.arange(0, 6.01, 0.25)  # between the edges of two discs
RESOLVED_SHARE = 0.9  # of the pairs that must be two contacts, at a gap and at all wider ones
HEADINGS = ("t/pitch, noise", "one contact, %", "centre, mm", "95 %, mm", "force, %", "gap, mm", "rings, %")


class Accuracy(NamedTuple):
    """One kind of image at one cover and noise."""

    single: float  # share of single discs that are detected as one contact
    off_mm: float  # from the true centre of pressure, median
    off_95_mm: float  # 95th percentile
    force: float  # median error over the true force
    gap_mm: float  # smallest resolved; infinite if none of GAPS_MM is
    rings: float  # share of rings that are detected as one contact


def press(skin, discs, noise, random):
    """Press discs (x, y, radius from the array's centre): true centre, true force, contacts raw and restored."""
    x, y = skin.surface.x, skin.surface.y
    return press_on(skin, sum(_inside(r - np.hypot(x - a, y - b)) for a, b, r in discs), noise, random)


def _inside(distance):
    """Pressure at distances (mm) from the border of what presses, positive within it."""
    return PEAK_KPA * np.clip(FINER * distance + 0.5, 0, 1)


def press_on(skin, pressure, noise, random):
    """Press by `pressure` (kPa, of the fine surface): as of `press`."""
    x, y = skin.surface.x, skin.surface.y
    clean = skin.surface.sense(pressure).reshape(SIDE, SIDE)
    sigma = noise * float(clean.max())
    frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
    restorer = make("auto", skin.blur, sigma)
    done = restorer(frame)
    total = pressure.sum()
    centre = np.array([(pressure * x).sum(), (pressure * y).sum()]) / total + (SIDE - 1) / 2
    find = Finder(skin.array, raster(skin.array, 1))
    restored = find(done.image, sigma * max(done.noise_gain, 1.0), deviation=restorer.deviation)
    return centre, total * skin.surface.grain**2 * 1e-3, (find(frame, sigma), restored)


def singles(skin, noise, repeats, seed):
    for number in range(repeats):
        random = np.random.default_rng([seed, number])
        x, y = random.uniform(-SIDE / 4, SIDE / 4, 2)
        yield press(skin, [(x, y, random.uniform(*RADIUS_MM))], noise, random)


def rings(skin, noise, repeats, seed):
    for number in range(repeats):
        random = np.random.default_rng([seed, number, 2])
        radius, width = random.uniform(*RING_RADIUS_MM), random.uniform(*RING_WIDTH_MM)
        x, y = random.uniform(-RINGS_OFF_MM, RINGS_OFF_MM, 2)
        distance = width / 2 - np.abs(np.hypot(skin.surface.x - x, skin.surface.y - y) - radius)
        yield press_on(skin, _inside(distance), noise, random)


def pairs(skin, gap, noise, repeats, seed):
    for number in range(repeats):
        random = np.random.default_rng([seed, number, 1])
        (x, y), angle = random.uniform(-1, 1, 2), random.uniform(0, np.pi)
        half = PAIR_RADIUS_MM + gap / 2
        a, b = half * np.cos(angle), half * np.sin(angle)
        yield press(skin, [(x + a, y + b, PAIR_RADIUS_MM), (x - a, y - b, PAIR_RADIUS_MM)], noise, random)


def measure(thickness, noise, repeats, seed=1):
    """The accuracy of the raw and of the restored image at one cover (pitches) and noise (of the frame's peak)."""
    skin = rubber(thickness, SIDE)
    one = list(singles(skin, noise, repeats, seed))
    two = [list(pairs(skin, gap, noise, max(repeats // 2, 2), seed)) for gap in GAPS_MM]
    ring = list(rings(skin, noise, repeats, seed))
    return [_accuracy(one, two, ring, image) for image in (0, 1)]


def _accuracy(one, two, ring, image):
    detected = [(centre, force, each[image][0]) for centre, force, each in one if len(each[image]) == 1]
    off = [np.hypot(*(centre - (got.x_mm, got.y_mm))) for centre, _, got in detected] or [np.nan]
    force = [abs(got.force / force - 1) for _, force, got in detected] or [np.nan]
    shares = [np.mean([len(each[image]) == 2 for _, _, each in same]) for same in two]
    widest = max((n for n, share in enumerate(shares) if share < RESOLVED_SHARE), default=-1)  # not resolved
    gap = float(GAPS_MM[widest + 1]) if widest + 1 < len(GAPS_MM) else np.inf
    whole = np.mean([len(each[image]) == 1 for *_, each in ring])
    return Accuracy(len(detected) / len(one), np.median(off), np.percentile(off, 95), np.median(force), gap, whole)


def contacts(repeats: int = 40, seed: int = 1) -> None:
    """Press discs into a 24 x 24 array of 1 mm pitch, one and two at a time, and look for them in both images."""
    rows, formats = [], ("{:.0%}", "{:.3f}", "{:.3f}", "{:.1%}", "{:g}", "{:.0%}")
    for thickness, noise in product(THICKNESSES, NOISES):
        each = zip(formats, *measure(thickness, noise, repeats, seed), strict=True)
        cells = (f"{form.format(raw)} / {form.format(restored)}" for form, raw, restored in each)
        rows.append((f"{thickness:g}, {100 * noise:g} %", *cells))
    print_table("Contacts, raw / restored", HEADINGS, rows)
    print(f"{repeats} discs, seed {seed}. {machine()}")
