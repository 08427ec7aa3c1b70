"""Every warning of an image: a code for programs, which never changes, and a text for people, which may."""

from typing import Literal

from tactiled.frames import Direction, FrameWarning

WarningCode = Literal[
    "uncalibrated", "thick_cover", "noise_unknown", "noise_high", "missing", "bad", "dead", "saturated",
    "cover_mismatch", "outliers", "negative", "offset", "noise_low", "plateau", "edge", "out_of_range", "faulty",
    "wrong_map", "cut_short", "below_zero",
]  # fmt: skip
TEXTS: dict[WarningCode, str] = {
    "uncalibrated": "pressure is in counts: calibrate, or give kpa_per_count{unused}",
    "thick_cover": "the cover is thick for a pitch of {pitch_mm:g} mm: at 1 % noise no gap {gap} survives it",
    "noise_unknown": "the noise is not measured yet: weak contacts are left out",
    "noise_high": "noise is {measured:.2g} {unit}, and {noise:.2g} {unit} was {source}",
    "missing": "{taxels} did not arrive: {instead}",
    "bad": "{taxels} reported faulty by the sensor: {instead}",
    "dead": "{taxels} dead: {instead}",
    "saturated": "{taxels} saturated: {their} pressure is a lower bound",
    "out_of_range": "{taxels} beyond the calibrated range: {their} pressure is extrapolated",
    "faulty": "{taxels} found not to work: {instead}",
    "below_zero": "{taxels} far below zero, as after a tare under a load: unload and tare",
    "wrong_map": "the map of taxels is wrong: {wrong}",
    "cover_mismatch": "the image does not match the data: check the cover settings and look for faulty taxels",
    "outliers": "single taxels disagree with their neighbours: list dead or damaged ones in calibration.dead",
    "negative": "readings are negative: unload and tare, or check noise_kpa",
    "offset": "no part of the array is free of pressure: if nothing lies on all of it, tare",
    "noise_low": "fine patterns have under half of the configured noise: lower noise_kpa, or taxels share noise",
    "plateau": "several taxels share the highest value: if saturated, set calibration.saturation to their counts",
    "cut_short": "the {budget_ms:.2g} ms for an image were over before its method was done: it could be sharper",
    "edge": "a contact reaches over the edge: pressure outside the array raises the taxels at the edge",
}


def warning(code: WarningCode, taxels: int | None = None, **values: object) -> FrameWarning:
    """The warning of a code; `values` fill in its text, and so does the number of `taxels` that it is about."""
    counted = (
        {"taxels": "1 taxel", "their": "its"} if taxels == 1 else {"taxels": f"{taxels} taxels", "their": "their"}
    )
    enough = " where enough is left" if code == "missing" else ""
    instead = "restored from {their} neighbours".format(**counted) + enough
    return FrameWarning(code, TEXTS[code].format(**{"instead": instead} | counted | values), taxels)


def cover_warning(
    thickness_mm: float, configured_mm: float, interval_mm: tuple[float, float] | None = None
) -> FrameWarning:
    """The warning that covers of a thickness, in an interval or up to it, fit better than the configured one."""
    direction: Direction = "thinner" if thickness_mm < configured_mm else "thicker"
    bounds = f"({interval_mm[0]:.2g} to {interval_mm[1]:.2g} mm)" if interval_mm else "or less"
    text = (
        f"the cover is {direction} than configured: {thickness_mm:.2g} mm {bounds} fits better than the configured"
    )
    text += f" {configured_mm:.2g} mm"
    return FrameWarning("cover_mismatch", text, None, round(thickness_mm, 3), direction, interval_mm)
