"""The report on what works: speed against accuracy, what can be known at all, what each rule earns."""

from collections.abc import Iterator
from pathlib import Path

from tactiled.study import ablation, discriminate, frontier
from tactiled.study.page import chart, table, text
from tactiled.study.peers import absent
from tactiled.study.report import Findings


def speed(folder: Path, found: Findings) -> Iterator[str]:
    """Speed against accuracy."""
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


def limits(folder: Path, found: Findings) -> Iterator[str]:
    """What no method can know."""
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


def rules(found: Findings) -> Iterator[str]:
    """What each rule of `auto` earns."""
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
