"""Where methods fail: each fault swept from harmless to hopeless, and whether the image shows that it is wrong."""

import csv
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactiled.diagnostics.checks import NOISE_RATIO, FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode
from tactiled.restore.methods import METHODS, make
from tactiled.restore.noise import estimate
from tactiled.study.faults import Case, Setting, Sweep, cases, sweeps
from tactiled.study.machine import describe
from tactiled.study.peers import skimage_restorations
from tactiled.study.scenes import TEST_SCENES
from tactiled.study.skin import Frames, Skin, nrmse, rms, rubber

COVER = 1.5  # t/pitch, of the rubber
OURS = tuple(name for name in METHODS if name != "raw")
PEERS = ("skimage wiener", "skimage rl")
PEER_BALANCE, PEER_ITERATIONS = 0.3, 30  # scikit-image's: weight over the noise, iterations
WORSE = 1.02  # times the raw image's error: more is a failure
HONEST = 0.5  # of the true error: a stated deviation below it shows nothing
NOISY: WarningCode = "noise_high"


@dataclass(frozen=True, slots=True)
class Row:
    """One method's image of one frame; errors and deviations are root mean squares in kPa."""

    sweep: str
    value: float
    scene: str
    method: str
    used: str  # the method that auto selected; empty for scikit-image's
    nrmse: float
    over_raw: float  # error over the raw image's
    error: float
    stated: float  # the image's stated standard deviation; NaN where there is none
    flagged: bool  # whether taxels have flags
    warnings: tuple[WarningCode, ...] = ()  # of the service at a first look

    @property
    def failed(self) -> bool:
        """Whether the image is worse than the raw one."""
        return self.over_raw > WORSE

    @property
    def noticed(self) -> bool:
        """Whether flags, a warning or the stated deviation show that the image may be wrong."""
        return self.flagged or bool(self.warnings) or self.stated >= HONEST * self.error


Results = Sequence[tuple[Sweep, list[Row]]]


@dataclass(frozen=True, slots=True)
class Failure:
    """Where a method becomes worse than the raw image, and whether that is noticed."""

    sweep: str
    unit: str
    method: str
    breaks_at: tuple[float, ...]  # first values on either side of the harmless one that are worse than raw
    worst: float  # largest error over the raw image's, mean of the scenes
    worst_at: float
    noticed: str  # "yes", "partly", "no", or "" where nothing failed


def setting(quick: bool, seed: int, skin: Skin | None = None) -> tuple[Setting, slice]:
    """What to run, on rubber if no skin is given, and which of each sweep's values."""
    if quick:
        return Setting(skin or rubber(COVER, 16), seed, ("blobs", "punches", "points")), slice(None, None, 3)
    return Setting(skin or rubber(COVER, 32), seed, tuple(TEST_SCENES)), slice(None)


def measure(setting: Setting, values: slice) -> Iterator[tuple[Sweep, list[Row]]]:
    """Run every sweep at the harmless value and a slice of the others."""
    for sweep in sweeps(setting):
        some = [v for v in sweep.values if v in sweep.values[values] or v == sweep.harmless]
        yield (
            sweep,
            [row for v in some for case in cases(setting, {sweep.name: v}) for row in rows(sweep.name, v, case)],
        )


def rows(sweep: str, value: float, case: Case) -> list[Row]:
    """Restore one frame by every method."""
    images: dict[str, tuple[str, Frames, float]] = {}
    for name in ("raw", *OURS):
        restorer = make(name, case.skin.blur, case.noise)
        for earlier in () if case.before is None else case.before:
            restorer(earlier, case.flags)
        done = restorer(case.frame, case.flags)
        images[name] = (done.method, done.image.copy(), rms(restorer.deviation()))
    images |= {name: ("", image, np.nan) for name, image in _peers(case).items()}
    raw = nrmse(images["raw"][1], case.truth)
    flagged = case.flags is not None and bool(case.flags.any())
    return [
        Row(
            sweep=sweep,
            value=value,
            scene=case.scene,
            method=name,
            used=used,
            nrmse=nrmse(image, case.truth),
            over_raw=nrmse(image, case.truth) / raw,
            error=rms(image - case.truth),
            stated=stated,
            flagged=flagged,
            warnings=_warnings(case, image, used),
        )
        for name, (used, image, stated) in images.items()
    ]


def _warnings(case: Case, image: Frames, used: str) -> tuple[WarningCode, ...]:
    flags = np.zeros(case.frame.shape, np.uint8) if case.flags is None else case.flags
    checks = FrameChecks(case.skin.blur, case.floor)
    found = checks.check(case.frame, flags, np.asarray(image, np.float32), case.noise, used)
    noisy = case.still is not None and estimate(case.still) > NOISE_RATIO * case.noise
    return (*found, NOISY) if noisy else found


def _peers(case: Case) -> dict[str, Frames]:
    """scikit-image's two, at settings that need no truth; they know nothing of flags."""
    if case.skin.psf is None:
        return {}
    balance = PEER_BALANCE * case.noise / max(float(case.frame.max()), case.noise)
    wiener, lucy = skimage_restorations(case.skin.psf, (balance,), (PEER_ITERATIONS,))
    return {PEERS[0]: wiener(case.frame), PEERS[1]: lucy(case.frame)}


def curve(found: list[Row], method: str) -> dict[float, float]:
    """Mean error of the scenes over the raw image's, by the value of the sweep."""

    def mean(value: float, name: str) -> float:
        return float(np.mean([row.nrmse for row in found if (row.value, row.method) == (value, name)]))

    return {value: mean(value, method) / mean(value, "raw") for value in dict.fromkeys(row.value for row in found)}


def breaks(ratios: dict[float, float], harmless: float) -> tuple[float, ...]:
    """The first value worse than raw on either side of the harmless one, or the harmless one itself."""
    if ratios.get(harmless, 0.0) > WORSE:
        return (harmless,)
    sides = (sorted((v for v in ratios if v < harmless), reverse=True), sorted(v for v in ratios if v > harmless))
    firsts = (next((value for value in side if ratios[value] > WORSE), None) for side in sides)
    return tuple(value for value in firsts if value is not None)


def failure(sweep: Sweep, found: list[Row], method: str) -> Failure:
    """Judge one method on one sweep."""
    ratios = curve(found, method)
    worst_at = max(ratios, key=lambda value: ratios[value])
    failed = [row.noticed for row in found if row.method == method and row.failed]
    word = "" if not failed else "yes" if all(failed) else "partly" if any(failed) else "no"
    count = f" ({sum(failed)} of {len(failed)})" if word in ("partly", "no") else ""
    return Failure(
        sweep=sweep.name,
        unit=sweep.unit,
        method=method,
        breaks_at=breaks(ratios, sweep.harmless),
        worst=ratios[worst_at],
        worst_at=worst_at,
        noticed=word + count,
    )


def failures(results: Results) -> list[Failure]:
    """Every method on every sweep, sweep by sweep."""
    methods = list(dict.fromkeys(row.method for row in results[0][1] if row.method != "raw"))
    return [failure(sweep, found, method) for sweep, found in results for method in methods]


HEADINGS = ("goes wrong", "methods worse than raw, from", "auto at its worst", "noticed on auto")


def lines(results: Results) -> list[tuple[str, ...]]:
    """A table by HEADINGS: where each method is first worse than raw, and whether that is noticed on auto."""
    table = []
    every = failures(results)
    for auto in (one for one in every if one.method == "auto"):
        broken = [one for one in every if one.sweep == auto.sweep and one.breaks_at]
        places = "; ".join(f"{one.method} {', '.join(f'{value:g}' for value in one.breaks_at)}" for one in broken)
        worst = f"{auto.worst:.2f} at {auto.worst_at:g}"
        cells = (places or "none", worst, auto.noticed or "nothing to notice")
        table.append((f"{auto.sweep} ({auto.unit})", *(_minus(cell) for cell in cells)))
    return table


SILENT_HEADINGS = ("goes wrong", "by", "scene", "error over raw", "true error, kPa", "stated, kPa")


def silent_lines(results: Results) -> list[tuple[str, ...]]:
    """A table by SILENT_HEADINGS: images of auto that are worse than raw and show it by nothing, worst first."""
    silent = [
        (row, sweep.unit)
        for sweep, found in results
        for row in found
        if row.method == "auto" and row.failed and not row.noticed
    ]
    silent.sort(key=lambda each: -each[0].over_raw)
    return [
        (
            row.sweep,
            _minus(f"{row.value:g} {unit}"),
            row.scene,
            f"{row.over_raw:.2f}",
            f"{row.error:.2f}",
            f"{row.stated:.2f}",
        )
        for row, unit in silent
    ]


def _minus(text: str) -> str:
    return text.replace(" -", " −") if not text.startswith("-") else "−" + text[1:]


def false_warnings(results: Results) -> str:
    """How many images of auto have a warning where restoration has the right settings."""
    sound = [
        row
        for sweep, found in results
        if sweep.name in ("cover", "white noise")
        for row in found
        if row.method == "auto"
    ]
    wrong = sum(bool(row.warnings) and not row.failed for row in sound)
    return f"Warnings on {len(sound)} images with the right settings: {wrong}."


def write(folder: Path, results: Results, seed: int) -> None:
    """Write every image to stability.csv, the failures to stability-table.csv, and a summary to stability.json."""
    table = [asdict(one) for one in failures(results)]
    _csv(folder / "stability.csv", [asdict(row) for _, found in results for row in found])
    _csv(folder / "stability-table.csv", table)
    silent = [dict(zip(SILENT_HEADINGS, line, strict=True)) for line in silent_lines(results)]
    about = {"seed": seed, "machine": describe(), "worse than raw by": WORSE}
    text = json.dumps(about | {"silent on auto": silent, "table": table}, indent=2)
    (folder / "stability.json").write_text(text + "\n", encoding="utf-8")


def _csv(path: Path, records: list[dict[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(records[0]))
        out.writeheader()
        for record in records:
            out.writerow({key: _cell(value) for key, value in record.items()})


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return f"{value:.6g}"
    return " ".join(str(_cell(each)) for each in value) if isinstance(value, tuple) else value
