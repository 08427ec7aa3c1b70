"""The report's page: what the charts show, in words, and the tables beside them."""

from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np

from tactiled.bench import (
    ablation,
    discriminate,
    frontier,
    frontier_chart,
    iterations,
    pairs,
    picard,
    stability,
    stability_files,
)
from tactiled.bench import stability_chart as charts
from tactiled.bench.machine import describe
from tactiled.bench.page import chart, page, table, text, tiles
from tactiled.bench.peers import absent
from tactiled.bench.report import Findings
from tactiled.bench.signs import SIGNS

SMALL_COVERS = (1.0, 3.0)  # t/pitch of the small chart
SMALL_SWEEPS = ("cover", "white noise", "thickness wrong", "dead taxels", "over the edge", "taxels out of place")


def write(folder: Path, found: Findings, seed: int) -> Path:
    """Draw every chart, write every table, and the page that holds them all; give its path."""
    frontier.write(folder, found.panels, seed)
    stability_files.write(folder, found.sweeps, seed)
    stability_files.write_pairs(folder, found.together)
    frontier_chart.draw(folder / "frontier.svg", found.panels)
    charts.draw(folder / "stability.svg", found.sweeps)
    charts.draw(folder / "stability-wiener.svg", found.sweeps, "wiener")
    charts.calibration(folder / "calibration.svg", found.sweeps)
    iterations.draw(folder / "iterations.svg", found.counts)
    picard.draw(folder / "picard.svg", found.modes)
    if found.pairs:
        discriminate.draw(folder / "two-points.svg", found.pairs)
    few = [one for one in found.panels if one.thickness in SMALL_COVERS]
    frontier_chart.draw(folder / "frontier-small.svg", few or found.panels)
    charts.draw(folder / "stability-small.svg", found.sweeps, only=SMALL_SWEEPS)
    path = folder / "index.html"
    parts = (_top(found, seed), _speed(folder, found), _limits(folder, found), _failures(folder, found))
    said = [each for part in (*parts, _doubt(folder), _rules(found)) for each in part]
    path.write_text(page("Speed against accuracy, and where methods fail", said), encoding="utf-8")
    return path


def _top(found: Findings, seed: int) -> Iterator[str]:
    yield "<h1>Speed against accuracy, and where methods fail</h1>"
    yield f"<p class='soft'>{escape(describe())}. One thread. Seed {seed}.</p>"
    yield tiles(_headlines(found))
    yield text(
        "Scenes are drawn four times finer than the taxels, off their grid, and blurred by the exact solution"
        " of the cover; restoration uses finite elements, so it never sees the kernel that blurred. Errors are"
        " ||image − truth|| / ||truth||, and none of our settings is tuned with the truth at hand.",
        "Rerun it on your own skin: `tactiled bench report --config CONFIG --out DIR`.",
    )
    links = (
        ("speed", "Speed"),
        ("limits", "Limits"),
        ("failures", "Failures"),
        ("doubt", "Doubt"),
        ("rules", "Rules"),
    )
    yield "<nav>" + "".join(f"<a href='#{name}'>{title}</a>" for name, title in links) + "</nav>"


def _headlines(found: Findings) -> Iterator[tuple[str, str]]:
    over = np.mean([one.mark("auto").nrmse / one.mark("raw").nrmse for one in found.panels])
    times = [one.mark("auto").median for one in found.panels]
    yield (
        f"{100 * abs(1 - over):.0f} % {'less' if over < 1 else 'more'} error",
        "auto against the raw image, mean of the panels below",
    )
    yield (
        f"{min(times):.0f} to {max(times):.0f} µs a frame",
        "auto's median, from the easiest panel to the hardest",
    )
    peers = [frontier.best_peer(one) for one in found.panels]
    if all(peers):
        faster = [p.median / o.mark("auto").median for p, o in zip(peers, found.panels, strict=True) if p]
        better = sum(o.mark("auto").nrmse < p.nrmse for p, o in zip(peers, found.panels, strict=True) if p)
        yield (
            f"{np.median(faster):.0f} x as fast",
            (
                f"as the most accurate setting of others' methods in each panel, and more accurate in {better}"
                f" of {len(peers)}"
            ),
        )
    broken = [one for one in stability.table(found.sweeps) if one.method == "auto" and one.breaks_at]
    names = ", ".join(f"{one.sweep} ({one.breaks_at[0]:g} {one.unit})" for one in broken[:3]).replace("-", "−")
    if len(broken) > 3:
        names += f" and {len(broken) - 3} more"
    yield f"{len(broken)} of {len(found.sweeps)} faults", f"make auto worse than the raw image: {names or 'none'}"


def _speed(folder: Path, found: Findings) -> Iterator[str]:
    yield "<h2 id='speed'>Speed against accuracy</h2>"
    yield text(
        "Every method restores the same films, frame after frame, in one run. Down and to the left is better. The"
        " dashed line is the best that any filter of the cover's modes could do if it were told the truth's own"
        " spectrum: no linear method passes it. Methods that know that pressure never pulls can, and do.",
    )
    yield chart(
        folder / "frontier.svg",
        "Error against time: filled marks are ours, hollow ones others' at fixed settings (nnls, under auto's"
        " star, is hollow to be seen). An arrow marks what lies above the scale.",
    )
    yield table(
        (
            "cover",
            "noise",
            "auto",
            "raw",
            "wiener",
            "rl-fast",
            "others' best",
            "floor",
            "beats auto in both",
        ),
        (_panel_row(one) for one in found.panels),
        good="nothing",
    )
    yield "<p class='soft'>NRMSE at the median time. Others' best is picked with the truth at hand.</p>"
    yield text(*frontier.verdict(found.panels), *_missing())


def _missing() -> Iterator[str]:
    if names := absent():
        yield f"Left out, as they are not installed (extra `peers`): {', '.join(names)}."


def _panel_row(one: frontier.Panel) -> tuple[str, ...]:
    cells = [_cell(one.mark(name)) for name in ("auto", "raw", "wiener", "rl-fast")]
    peer = frontier.best_peer(one)
    theirs = f"{_cell(peer)}, {peer.method}" if peer else "–"
    skin = one.skin.replace(" ", "\u00a0")
    return (skin, f"{100 * one.noise:g} %", *cells, theirs, f"{one.floor:.3f}", frontier.rivals(one))


def _cell(mark: frontier.Mark) -> str:
    return f"{mark.nrmse:.3f} at {mark.median:.0f}\u00a0µs"


def _limits(folder: Path, found: Findings) -> Iterator[str]:
    yield "<h2 id='limits'>What can be known at all</h2>"
    yield text(
        "A cover weakens each pattern by its singular value; a pattern that sinks under the noise is lost to every"
        " linear method. Dividing by the singular value (red) then gives back noise, not the scene.",
    )
    yield chart(
        folder / "picard.svg",
        "Left: singular values; a dot marks the last pattern of the scene above the noise. Right: the modes of one"
        " frame, in the blur's own order (grey: each, lines: their running root mean square).",
    )
    if not found.pairs:
        return
    yield "<h3>Two points</h3>"
    yield text(
        "Two small indenters are told apart where the image dips between them by more than it does under one of"
        f" their total force in {100 * discriminate.SURE:g} % of the trials. The Cramér-Rao bound knows that"
        " there are two small indenters, which no image does; and cells of a whole pitch cannot show a dip"
        " over less than two.",
    )
    yield chart(folder / "two-points.svg", "Two-point discrimination at 1 % noise, gap between the two middles.")
    names = discriminate.METHODS
    rows = ((one.skin, *(f"{one.least(name):g}" for name in names), f"{one.bound:.2f}") for one in found.pairs)
    yield table(("smallest gap, pitches", *names, "bound"), rows)


def _failures(folder: Path, found: Findings) -> Iterator[str]:
    yield "<h2 id='failures'>Where methods fail</h2>"
    yield text(
        "One thing at a time goes wrong, from harmless (dotted line) to hopeless. A method breaks where its"
        " mean error over the scenes is more than 2 % above the raw image's. It was noticed where the image"
        " comes with a warning, or where the standard deviation that we claim is at least half the true"
        " error. Signs are what a frame and its image show without the truth. Each has the"
        f" limit that all but {100 * stability.ALARMS:g} % of sound images keep: "
        + "; ".join(f"{k}, {v}" for k, v in SIGNS.items())
        + ".",
    )
    yield chart(
        folder / "stability.svg", "Error over the raw image's; in the shaded part the raw image is the better one."
    )
    failures = stability.table(found.sweeps)
    yield table(
        stability.HEADINGS, stability.lines(failures), good="never|yes|nothing to notice", bad="no .*|partly .*"
    )
    yield "<h3>Two at once</h3>"
    yield text(
        "Every pair of the faults that hurt most alone, at two strengths each; the ten that hurt auto most. Errors"
        " are over the raw image's.",
        pairs.verdict(found.together),
    )
    yield table(pairs.HEADINGS, pairs.lines(pairs.worst(found.together, 10)), good="nothing to notice")
    yield "<h3>Silent failures of auto</h3>"
    silent = stability.silent(found.sweeps)
    worse = [row for row in silent if row.over_raw > stability.WORSE]
    total = sum(row.method == "auto" for _, rows in found.sweeps for row in rows)
    yield text(
        f"Of {total} images {len(silent)} are over twice as wrong as claimed with nothing to warn of it, and"
        f" {len(worse)} of these are worse than the raw image: they are listed here, worst first.",
    )
    said = stability.false_warnings(found.sweeps, "auto")
    yield text(
        f"Of {len(stability.sound(found.sweeps, 'auto'))} sound images the service would warn of {len(said)}"
        f" wrongly at a first look; it says nothing before it has seen the same three times running.",
        f"Of {found.alarms.frames} more sound frames, scenes at other places under the covers and noises above,"
        f" {found.alarms.wrong} ({100 * found.alarms.wrong / found.alarms.frames:.2f} %) come with a warning"
        f" at a first look{_said(found.alarms.said)}.",
    )
    yield text(
        "Not to be seen in a frame: an offset or a drift that lifts the array unevenly, or by less than 2 % of the"
        " highest pressure restored, as it is what a wide, faint press would be.",
    )
    known = stability.limits(found.sweeps, "auto")
    worst = sorted(worse, key=lambda row: -row.over_raw)
    yield table(
        ("goes wrong", "by", "scene", "error over raw", "true error, kPa", "claimed, kPa", "shown by"),
        ((*_where(row), ", ".join(stability.shown(row, known)) or "nothing") for row in worst),
        bad="nothing",
    )
    yield "<h3>What a frame shows of a fault</h3>"
    yield text(
        "A limit is what sound images keep: those where restoration is told the truth about cover and noise. False"
        " alarms are counted on sound images of each scene by the limits that the other scenes would set.",
    )
    yield table(("sign", "what it is", "limit", "false alarms", "silent images that it shows"), _signs(found))
    yield "<details><summary>The same against our Wiener filter</summary>"
    yield chart(folder / "stability-wiener.svg", "Error over the Wiener filter's.")
    yield "</details>"
    yield "<h3>Too many iterations</h3>"
    yield chart(
        folder / "iterations.svg",
        f"Richardson-Lucy under rubber, t/pitch {stability.COVER:g}, fits the noise if let to; ours stops when"
        " the residual has come down to it.",
    )


def _said(counts: dict[str, int]) -> str:
    return "".join(f"; {count} x “{said}”" for said, count in sorted(counts.items()))


def _signs(found: Findings) -> Iterator[tuple[str, ...]]:
    known, fine = stability.limits(found.sweeps, "auto"), stability.sound(found.sweeps, "auto")
    silent = stability.silent(found.sweeps)
    for name, meaning in SIGNS.items():
        alarms = stability.alarms(found.sweeps, "auto").count(name)
        counts = {
            sweep.name: [name in stability.shown(row, known) for row in silent if row.sweep == sweep.name]
            for sweep, _ in found.sweeps
        }
        caught = (f"{fault} {sum(each)} of {len(each)}" for fault, each in counts.items() if any(each))
        limit = f"{known[name]:.2f}" if name in known else "–"
        yield name, meaning, limit, f"{alarms} of {len(fine)}", "; ".join(caught) or "none"


def _where(row: stability.Row) -> tuple[str, ...]:
    figures = (f"{row.over_raw:.2f}", f"{row.error:.2f}", f"{row.claimed:.2f}")
    return (row.sweep, f"{row.value:g}".replace("-", "−"), row.scene, *figures)


def _doubt(folder: Path) -> Iterator[str]:
    yield "<h2 id='doubt'>Doubt, as claimed and as it is</h2>"
    yield text(
        "Every image comes with a standard deviation. On the line it is right; below it is cautious; in the shaded"
        " part the image is over twice as wrong as it says. Saturated frames there carry a warning; the others"
        " do not.",
    )
    yield chart(
        folder / "calibration.svg", "Claimed standard deviation of auto against its true error, root mean squares."
    )


def _rules(found: Findings) -> Iterator[str]:
    yield "<h2 id='rules'>What each rule of auto earns</h2>"
    yield text(
        "Films of every scene, moving, each after a rest, under every cover and one of a tenth of the pitch,"
        " restored by auto with all its rules and with one of them off. Error is the mean NRMSE of the pressed"
        " frames, of all and, as a factor, of those that come out otherwise. Times are the thread's own, of all"
        " frames: a cold fit of points takes 50 times as long as another frame, so that a few of them make up most"
        " of the mean.",
    )
    rows = (
        (
            f"{one.rule}: {ablation.RULES[one.rule][0]}",
            f"{one.frames} of {one.of}",
            f"{one.time:.1f} / {one.time_without:.1f}",
            f"{one.median:.1f} / {one.median_without:.1f}",
            f"{one.error:.4f} / {one.error_without:.4f}",
            f"{one.worse:.2f} x",
            f"{one.changes} / {one.changes_without}",
        )
        for one in found.rules
    )
    heads = (
        "mean µs, with / without",
        "median µs",
        "error, with / without",
        "there, without it",
        "changes of method",
    )
    yield table(("rule", "frames that it decides", *heads), rows)
