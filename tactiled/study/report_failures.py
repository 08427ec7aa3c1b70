"""The report on what does not work: where methods fail, alone and in pairs, who notices, and what stays silent."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from tactiled.study import claims, pairs, silence, stability, stability_table
from tactiled.study.page import chart, table, text
from tactiled.study.report import Findings
from tactiled.study.signs import SIGNS
from tactiled.study.stability import WORSE


def failures(folder: Path, found: Findings) -> Iterator[str]:
    """Where methods fail, and whether anyone would notice."""
    yield from _alone(folder, found)
    yield from _together(found)
    yield from silent_failures(found.sweeps, found.together)
    yield from _warnings(found)
    yield from _signs(found)
    yield "<details><summary>The same against our Wiener filter</summary>"
    yield chart(folder / "stability-wiener.svg", "Error over the Wiener filter's.")
    yield "</details>"
    yield "<h3>Too many iterations</h3>"
    yield chart(
        folder / "iterations.svg",
        f"Richardson-Lucy under rubber, t/pitch {stability.COVER:g}, fits the noise if let to; ours stops when"
        " the residual has come down to it.",
    )


def doubt(folder: Path, found: Findings) -> Iterator[str]:
    """Claimed against true deviation."""
    yield "<h2 id='doubt'>Doubt, as claimed and as it is</h2>"
    yield text(
        "Every image comes with a standard deviation. On the line it is right; below it is cautious; in the shaded"
        " part the image is over twice as wrong as it says. Filled marks come with a warning.",
    )
    yield chart(
        folder / "calibration.svg", "Claimed standard deviation of auto against its true error, root mean squares."
    )
    if short := claims.lines(found.sweeps, found.together):
        yield text(
            "The same of images that are worse than the raw one. A claim cannot know of what nobody told it."
        )
        yield table(claims.HEADINGS, short)


def _alone(folder: Path, found: Findings) -> Iterator[str]:
    yield "<h2 id='failures'>Where methods fail</h2>"
    yield text(
        "One thing at a time goes wrong, from harmless (dotted line) to hopeless. A method breaks where its"
        f" mean error over the scenes is more than {100 * (WORSE - 1):.0f} % above the raw image's. It was noticed"
        " where the image comes with a warning, or where the standard deviation that we claim is at least half the"
        " true error.",
    )
    yield chart(
        folder / "stability.svg", "Error over the raw image's; in the shaded part the raw image is the better one."
    )
    found_ = stability_table.lines(stability.table(found.sweeps))
    yield table(stability_table.HEADINGS, found_, good="never|yes|nothing to notice", bad="no .*|partly .*")


def _together(found: Findings) -> Iterator[str]:
    yield "<h3>Two at once</h3>"
    yield text(
        "Every pair of the faults that hurt most alone, at two strengths each; the ten that hurt auto most. Errors"
        " are over the raw image's.",
        pairs.verdict(found.together),
    )
    yield table(pairs.HEADINGS, pairs.lines(pairs.worst(found.together, 10)), good="nothing to notice")


def silent_failures(found: stability.Found, together: Sequence[pairs.Pair]) -> Iterator[str]:
    """Every image that is worse than raw with nothing to tell of it, and why."""
    yield "<h3>Silent failures of auto</h3>"
    listed = silence.listed(found, together)
    yield text(silence.verdict(listed))
    if listed:
        yield table(silence.HEADINGS, silence.lines(listed), bad=silence.UNKNOWN)


def _warnings(found: Findings) -> Iterator[str]:
    yield "<h3>False warnings</h3>"
    said = stability.false_warnings(found.sweeps, "auto")
    more = found.alarms
    yield text(
        f"Of {len(stability.sound(found.sweeps, 'auto'))} sound images the service would warn of {len(said)}"
        " wrongly at a first look; it says nothing before it has seen the same three times running.",
        f"Of {more.frames} more sound frames, scenes at other places under the covers and noises above,"
        f" {more.wrong} ({100 * more.wrong / more.frames:.2f} %) come with a warning at a first look"
        + "".join(f"; {count} x {code}" for code, count in sorted(more.said.items()))
        + ".",
    )


def _signs(found: Findings) -> Iterator[str]:
    silent = stability.silent(found.sweeps)
    total = sum(row.method == "auto" for _, rows in found.sweeps for row in rows)
    yield "<h3>What a frame shows of a fault</h3>"
    yield text(
        "Signs are what a frame and its image show without the truth; warnings are made of some of them. Each has"
        f" the limit that all but {100 * stability.ALARMS:g} % of sound images keep: those where restoration is"
        " told the truth about cover and noise. False alarms are counted on sound images of each scene by the"
        f" limits that the other scenes would set. Of {total} images with one fault {len(silent)}, most of them"
        " better than raw, are over twice as wrong as claimed with nothing to warn of it.",
    )
    yield table(("sign", "what it is", "limit", "false alarms", "of these it shows"), _sign_rows(found))


def _sign_rows(found: Findings) -> Iterator[tuple[str, ...]]:
    known, fine = stability.limits(found.sweeps, "auto"), stability.sound(found.sweeps, "auto")
    silent, alarms = stability.silent(found.sweeps), stability.alarms(found.sweeps, "auto")
    for name, meaning in SIGNS.items():
        counts = {
            sweep.name: [name in stability.shown(row, known) for row in silent if row.sweep == sweep.name]
            for sweep, _ in found.sweeps
        }
        caught = (f"{fault} {sum(each)} of {len(each)}" for fault, each in counts.items() if any(each))
        limit = f"{known[name]:.2f}" if name in known else "–"
        yield name, meaning, limit, f"{alarms.count(name)} of {len(fine)}", "; ".join(caught) or "none"
