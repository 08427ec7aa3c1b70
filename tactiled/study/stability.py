"""Where methods fail: each fault swept from harmless to hopeless, and whether the image shows that it is wrong."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from rich.progress import track

from tactiled.diagnostics.checks import NOISE_RATIO, FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode
from tactiled.restore.methods import METHODS, make
from tactiled.restore.noise import estimate
from tactiled.study.faults import Case, Setting, Sweep, cases, sweeps
from tactiled.study.peers import skimage_restorations
from tactiled.study.results import write_csv, write_json
from tactiled.study.scenes import TEST_SCENES
from tactiled.study.skin import Frames, Skin, nrmse, rms, rubber

COVER = 1.5  # t/pitch, of the rubber
OURS = tuple(name for name in METHODS if name != "raw")
PEERS = ("skimage wiener", "skimage rl")
PEER_BALANCE, PEER_ITERATIONS = 0.3, 30  # scikit-image's: weight over the noise, iterations
WORSE = 1.02  # times the raw image's error: more is a failure
HONEST = 0.5  # of the true error: a stated deviation below it shows nothing


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


def setting(reduced: bool, seed: int, skin: Skin | None = None) -> Setting:
    """What to run, on rubber if no skin is given."""
    if reduced:
        return Setting(skin or rubber(COVER, 16), seed, ("blobs", "punches", "points"), step=3)
    return Setting(skin or rubber(COVER, 32), seed, tuple(TEST_SCENES))


def measure(setting: Setting) -> Results:
    """Run every sweep."""
    return [(sweep, run(setting, sweep)) for sweep in track(sweeps(setting), "Faults", transient=True)]


def run(setting: Setting, sweep: Sweep) -> list[Row]:
    """Restore every scene at the sweep's harmless value and every step-th of the others."""
    values = [v for v in sweep.values if v in sweep.values[:: setting.step] or v == sweep.harmless]
    return [row for v in values for case in cases(setting, sweep, v) for row in restore(sweep.name, v, case)]


def restore(sweep: str, value: float, case: Case) -> list[Row]:
    """Restore one frame by every method."""
    images: dict[str, tuple[str, Frames, float]] = {}
    for name in ("raw", *OURS):
        restorer = make(name, case.skin.blur, case.noise)
        for earlier in case.before:
            restorer(earlier, case.flags)
        done = restorer(case.frame, case.flags)
        images[name] = done.method, done.image.copy(), rms(restorer.deviation())
    images |= {name: ("", image, np.nan) for name, image in _peers(case).items()}
    raw, flagged = nrmse(images["raw"][1], case.truth), bool(case.flags.any())
    rows = []
    for name, (used, image, stated) in images.items():
        error = nrmse(image, case.truth)
        errors = error, error / raw, rms(image - case.truth)
        warnings = _warnings(case, image, used)
        rows.append(Row(sweep, value, case.scene, name, used, *errors, stated, flagged, warnings))
    return rows


def _warnings(case: Case, image: Frames, used: str) -> tuple[WarningCode, ...]:
    checks = FrameChecks(case.skin.blur, case.floor)
    warnings = checks.check(case.frame, case.flags, np.asarray(image, np.float32), case.noise, used)
    noisy = case.still is not None and estimate(case.still) > NOISE_RATIO * case.noise
    return (*warnings, "noise_high") if noisy else warnings


def _peers(case: Case) -> dict[str, Frames]:
    """scikit-image's two, at settings that need no truth; they know nothing of flags."""
    if case.skin.psf is None:
        return {}
    balance = PEER_BALANCE * case.noise / max(float(case.frame.max()), case.noise)
    restorations = skimage_restorations(case.skin.psf, (balance,), (PEER_ITERATIONS,))
    return {name: restoration(case.frame) for name, restoration in zip(PEERS, restorations, strict=True)}


def curve(rows: list[Row], method: str) -> dict[float, float]:
    """Mean error of the scenes over the raw image's, by the value of the sweep."""

    def mean(value: float, name: str) -> float:
        return float(np.mean([row.nrmse for row in rows if (row.value, row.method) == (value, name)]))

    return {value: mean(value, method) / mean(value, "raw") for value in dict.fromkeys(row.value for row in rows)}


def breaks(ratios: dict[float, float], harmless: float) -> list[float]:
    """The first value worse than raw on either side of the harmless one, or the harmless one itself."""
    worse = sorted(value for value, ratio in ratios.items() if ratio > WORSE)
    if harmless in worse:
        return [harmless]
    below, above = ([v for v in worse if v < harmless], [v for v in worse if v > harmless])
    return below[-1:] + above[:1]


HEADINGS = ("goes wrong", "methods worse than raw, from", "auto at its worst", "noticed on auto")


def lines(results: Results) -> list[tuple[str, ...]]:
    """A table by HEADINGS: where each method is worse than raw, and how many failures of auto are noticed."""
    table = []
    for sweep, rows in results:
        places = []
        for method in dict.fromkeys(row.method for row in rows if row.method != "raw"):
            if values := breaks(curve(rows, method), sweep.harmless):
                places.append(f"{method} {', '.join(f'{value:g}' for value in values)}")
        at, worst = max(curve(rows, "auto").items(), key=lambda each: each[1])
        failed = [row.noticed for row in rows if row.method == "auto" and row.failed]
        noticed = f"{sum(failed)} of {len(failed)}" if failed else "nothing to notice"
        cells = ("; ".join(places) or "none", f"{worst:.2f} at {at:g}", noticed)
        table.append((f"{sweep.name} ({sweep.unit})", *(cell.replace(" -", " −") for cell in cells)))
    return table


def verdict(results: Results) -> tuple[str, str]:
    """How many failures of auto nothing shows, and how many warnings there are with the right settings."""
    every = [(sweep.name, row) for sweep, rows in results for row in rows if row.method == "auto"]
    silent = sum(row.failed and not row.noticed for _, row in every)
    sound = [row for name, row in every if name in ("cover", "white noise")]
    wrong = sum(bool(row.warnings) and not row.failed for row in sound)
    return (
        f"Images of auto that are worse than the raw image, and show it by nothing: {silent} of {len(every)}.",
        f"Warnings on {len(sound)} images with the right settings: {wrong}.",
    )


def write(folder: Path, results: Results, seed: int) -> None:
    """Draw both charts, write every image to stability.csv, and the table to stability.json."""
    from tactiled.study import stability_chart

    stability_chart.draw(folder / "stability.svg", results)
    stability_chart.calibration(folder / "calibration.svg", results)
    columns = [*(field.name for field in fields(Row)), "noticed"]
    every = (row for _, rows in results for row in rows)
    write_csv(folder / "stability.csv", columns, ((*astuple(row), row.noticed) for row in every))
    table = [dict(zip(HEADINGS, line, strict=True)) for line in lines(results)]
    write_json(folder / "stability.json", {"seed": seed, "worse than raw by": WORSE, "table": table})
