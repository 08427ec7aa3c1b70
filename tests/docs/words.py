"""Tables of names that the package lists, each with its meaning; a name without a meaning is a KeyError."""

from collections.abc import Iterator, Mapping
from typing import get_args

from tactiled.bus.faults import KINDS
from tactiled.diagnostics.warning_codes import TEXTS, warning
from tactiled.restore import auto
from tactiled.restore import methods as table_of_methods
from tactiled.restore import points as fit
from tactiled.runtime.events import Kind
from tactiled.web.schemas import Loss
from tests.docs.table import code, sentence, table

LOSS = {
    "lost": "A message was missing when its frame was closed. The frame is marked.",
    "repeated": "A message came twice. The second one is dropped.",
    "late": "A message came after its frame was closed, and is dropped; or after a later segment, and is used.",
    "foreign": "A message belongs to no configured sensor. It is dropped.",
    "malformed": "A message on the sensor's id does not fit its layout. It is dropped.",
    "incomplete": "A frame was published with taxels missing. It is marked.",
    "skipped": "A frame was not restored because a newer one was there. It is dropped.",
    "dropped": "Linux discarded a message that was not read in time (sockets only). It also counts as `lost`.",
    "unreadable": "The bus interface could not decode a message. It counts for every sensor of the bus.",
    "errors": "The bus interface reported an error frame. It is dropped.",
    "bus_off": "The interface left the bus because of errors (SocketCAN). The sensor is `down` until it is back.",
    "unsent": "The bus did not take a message to a skin that must be asked or started. A request is not repeated, "
    "as the next one is due; a start is repeated after 1 s.",
}
ERRORS = {
    "tx_timeout": "transmission timed out",
    "lost_arbitration": "arbitration was lost",
    "protocol": "protocol violation",
    "transceiver": "transceiver status",
    "no_ack": "no acknowledgement",
    "bus_off": "the controller left the bus",
    "bus_error": "bus error",
    "restarted": "the controller restarted",
    "rx_overflow": "receive buffer overflow",
    "tx_overflow": "transmit buffer overflow",
    "rx_warning": "receive errors reached the warning level",
    "tx_warning": "transmit errors reached the warning level",
    "rx_passive": "receive errors made the controller passive",
    "tx_passive": "transmit errors made the controller passive",
    "active": "the controller is active again",
    "controller": "controller problem of no known kind",
    "other": "any other; also every error frame of an interface that does not report the kind",
}
EVENTS = {
    "sensor_live": "Frames of the sensor come.",
    "sensor_stale": "No frame came for `stale_after_s`, or the last one failed.",
    "sensor_silent": "No frame has come since the bus was opened.",
    "sensor_down": "The bus of the sensor is not available.",
    "bus_up": "The bus is available again.",
    "bus_down": "The bus is not available.",
    "warning_raised": "A warning appeared.",
    "warning_cleared": "A warning has not appeared for 1 s.",
    "method_set": "A client selected a method.",
    "method_kept": "The service started with a kept method.",
    "state_ignored": "The file of kept methods has an entry that does not apply.",
    "tare_asked": "A client started a tare.",
    "tare_done": "The tare is complete.",
    "tare_lapsed": "The tare was given up because frames stopped.",
    "recording_started": "A client started a recording.",
    "recording_ended": "A recording ended, with the reason if it ended early.",
    "fault_raised": "A part of the service failed; it continues.",
    "fault_cleared": "That part has not failed for 1 s.",
    "replay_stepped": "The clock of the replayed recording stepped.",
}
METHODS = {
    "auto": ("selects one of the methods below for every frame", "always, unless you compare methods"),
    "raw": ("leaves the calibrated frame unchanged", "to see what the sensor measured"),
    "wiener": (
        "Wiener filter in the modes of the blur; keeps the total force",
        "wide, smooth presses; when the image must stay linear in the frame, with negative values",
    ),
    "rl": (
        "Richardson-Lucy with the weights HᵀI of the frame; at most 30 iterations, stopped at the noise",
        "to compare with other work",
    ),
    "rl-fast": (
        "the same, accelerated after Biggs and Andrews; at most 24 iterations",
        "to compare with other work",
    ),
    "nnls": (
        "non-negative least squares by ADMM, started from the previous image",
        "sharp or sparse contacts: punches, rings, Braille dots, edges",
    ),
    "tv": (
        "`nnls` with isotropic total variation; weights from noise, contrast and the spectrum of the scene; "
        "`nnls` if the layout is not a grid",
        "flat parts with sharp edges",
    ),
    "points": (
        "up to eight loads smaller than a taxel, each with its place and force; `nnls` if a few points "
        "do not explain the frame, or if the cover is too thin to locate them",
        "isolated sharp indenters on a grid",
    ),
}
REASONS = {
    auto.IDLE: "`idle`",
    auto.RAW: "`raw`",
    auto.RAW_POINTS: "`raw`",
    auto.WIENER: "`wiener`",
    auto.NNLS: "`nnls`",
    auto.MIXED: "`nnls`, mixed with the raw image",
    auto.POINTS: "`points`",
    table_of_methods.BY_HAND: "the method that was selected by hand",
    table_of_methods.NO_POINTS: "`nnls` in place of `points`",
    fit.NO_GRID: "`nnls` in place of `points`",
    fit.TOO_THIN: "`nnls` in place of `points`",
    table_of_methods.NO_AREA: "`nnls` in place of `tv`",
}
WARNINGS = {
    "uncalibrated": "Set `calibration.kpa_per_count`.",
    "thick_cover": "The cover destroys finer detail; use a thinner or stiffer one if you need it.",
    "noise_high": "Look for interference; or correct `noise_kpa`.",
    "missing": "Look for lost messages in the counts of [the bus](bus.md).",
    "bad": "The board reports these taxels as out of range or not connected.",
    "dead": "`calibration.dead` lists these taxels.",
    "saturated": "The load exceeds the range of the taxels.",
    "cover_mismatch": "Compare the cover's settings, above all its thickness, with the real cover; look for "
    "faulty taxels.",
    "outliers": "List taxels that do not work in `calibration.dead`.",
    "negative": "Unload the array and tare it; or correct `noise_kpa`.",
    "offset": "If nothing presses on all of the array, tare it.",
    "noise_low": "Correct `noise_kpa`; or neighbouring taxels share their noise.",
    "plateau": "Set `calibration.saturation`.",
    "edge": "Do not trust the rows at the edge.",
}
WARNING_VALUES = {
    "pitch_mm": 1, "gap": "finer than 3.1 mm", "measured_kpa": 0.5, "noise_kpa": 0.2, "source": "configured"
}  # fmt: skip


def loss() -> Iterator[str]:
    yield from table(("Count", "Meaning"), ([code(name), LOSS[name]] for name in Loss.model_fields))


def error_kinds() -> Iterator[str]:
    yield from table(("Kind", "Meaning"), ([code(name), sentence(ERRORS[name])] for name in KINDS))


def events() -> Iterator[str]:
    yield from table(("`kind`", "Meaning"), ([code(name), EVENTS[name]] for name in get_args(Kind)))


def methods() -> Iterator[str]:
    rows = ([code(name), *map(sentence, METHODS[name])] for name in table_of_methods.METHODS)
    yield from table(("`method`", "What it does", "When to use it"), rows)


def reasons() -> Iterator[str]:
    _all_of(REASONS, auto, fit, table_of_methods)
    yield from table(("`why`", "Method used"), REASONS.items())


def warnings() -> Iterator[str]:
    rows = ([code(each), warning(each, 2, **WARNING_VALUES).text, WARNINGS[each]] for each in TEXTS)
    yield from table(("`code`", "Text", "What to do"), rows)


def _all_of(known: Mapping[str, str], *modules: object) -> None:
    """KeyError where a module has a sentence that is not known."""
    for module in modules:
        for name, text in vars(module).items():
            if name.isupper() and isinstance(text, str) and " " in text and text not in known:
                raise KeyError(f"{name}: {text}")
