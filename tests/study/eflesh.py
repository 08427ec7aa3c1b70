"""Curves and hysteresis of a real skin, eFlesh's normal-force presses: one trial fitted, the other predicted."""

from itertools import permutations
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from tactiled.calibrate.curve_fit import Points, choose_form, fit, hysteresis, value
from tactiled.calibrate.curves import FORMS
from tactiled.cli.bench import print_table
from tactiled.study.charts import COLOURS, figure

POINTS = 400  # of a trial, in time
FOLDS = 10  # presses of a trial
MIN_LOAD = 0.03  # of the largest, and less: the probe is off the skin
HEADINGS = ("channel", "line, left out", "power", "cubic", "spline", "chosen", "hysteresis", "line, in sample")


def trial(folder):
    """Load (M,), counts (M, 15) upwards, direction (M,) and press (M,) of a trial, where the skin is pressed."""
    sensor = np.loadtxt(folder / "sensor_post_baselines.csv", delimiter=",")
    states = np.loadtxt(folder / "states.csv", delimiter=",")
    read = states[:, 4] >= 0  # -1: no load was read
    times, counts = sensor[:, 0], sensor[:, 1:]
    load = np.interp(times, states[read, 0], states[read, 4])
    pieces = np.array_split(np.arange(times.size), POINTS)
    load, counts, z = (
        np.array([each[some].mean(axis=0) for some in pieces]) for each in (load, counts, states[:, 3])
    )
    counts = counts * np.sign(np.corrcoef(load, counts.T)[0, 1:])
    used = load > MIN_LOAD * load.max()
    press = np.cumsum(np.diff(used, prepend=False) & used)[used]
    direction = np.where(np.gradient(z) < 0, 1, -1).astype(np.int8)
    return load[used], counts[used], direction[used], press


def points(load, counts, direction, press):
    return Points(counts[:, None, None], load, direction, press, press)


def measure(trials):
    """A row of HEADINGS for each channel, and for all of them the line through all channels."""
    for channel in range(trials[0][1].shape[1]):
        errors = {form: [] for form in FORMS}
        loops, selected, inside = [], [], []
        for (load, counts, *rest), (other_load, other_counts, *_) in permutations(trials, 2):
            mine = points(load, counts[:, channel], *rest)
            end = np.array([counts[:, channel].max()])
            for form in FORMS:
                fitted = fit(mine, end, form)
                relative = other_counts[:, [channel], None] / end
                got = value(form, fitted.parameters, relative, mine.weight)[:, 0]
                errors[form].append(100 * np.sqrt(np.mean((got - other_load) ** 2)) / other_load.max())
            selected.append(choose_form(mine, end)[0])
            loops.append(hysteresis(fit(mine, end, selected[-1]), mine)[0])
            inside.append(100 * np.sqrt(np.mean(fit(mine, end, "linear").residuals ** 2)) / load.max())
        means = [f"{np.mean(errors[form]):.1f} %" for form in FORMS]
        yield (
            str(channel),
            *means,
            "/".join(dict.fromkeys(selected)),
            f"{np.mean(loops):.1f} %",
            f"{np.mean(inside):.1f} %",
        )


def together(trials):
    """Rms error (% of the largest load) of a line through all channels: in sample, and of the other trial."""
    inside, outside = [], []
    for (load, counts, *_), (other_load, other_counts, *_) in permutations(trials, 2):
        factors = np.linalg.lstsq(counts, load, rcond=None)[0]
        for rows, loads, errors in ((counts, load, inside), (other_counts, other_load, outside)):
            errors.append(100 * np.sqrt(np.mean((rows @ factors - loads) ** 2)) / loads.max())
    return np.mean(inside), np.mean(outside)


def draw(path, trials, channels=(3, 7, 12)):
    """Draw load over counts of some channels in both trials, hollow while the load falls."""
    with figure(path, 11, 4.2) as chart:
        for axes, channel in zip(chart.subplots(1, len(channels)), channels, strict=True):
            for (load, counts, direction, press), colour, name in zip(
                trials, COLOURS, ("first", "second"), strict=False
            ):
                rising, one = direction > 0, counts[:, channel]
                axes.plot(one[rising], load[rising], ".", color=colour, label=f"{name} trial")
                axes.plot(one[~rising], load[~rising], "o", mfc="none", ms=4, color=colour)
                mine = points(load, one, direction, press)
                end = np.array([one.max()])
                fitted = fit(mine, end, choose_form(mine, end)[0])
                line = np.linspace(0, 1, 100)
                fitted_load = value(fitted.form, fitted.parameters, line[:, None, None], mine.weight)
                axes.plot(line * end, fitted_load, color=colour, lw=1)
            axes.set(title=f"channel {channel}", xlabel="counts over no load", ylabel="load (unit not stated)")
            axes.legend()


def eflesh(
    folder: Annotated[Path, typer.Argument(help="Folder with the trials' folders.")],
    plot: Annotated[Path | None, typer.Option(help="Chart of some channels.")] = None,
):
    """Fit each channel's curve in one trial of eFlesh's presses, and predict the load of the other trial."""
    trials = [trial(each) for each in sorted(folder.glob("*_probe"))]
    print_table("rms error of the load, % of the largest", HEADINGS, measure(trials))
    inside, outside = together(trials)
    print(f"a line through all channels leaves {inside:.1f} % in sample, and {outside:.1f} % of the other trial")
    if plot is not None:
        draw(plot, trials)
