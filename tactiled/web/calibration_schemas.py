"""Answers on a sensor's calibration: its tare, its curves and its taxels' health."""

from typing import Literal

from pydantic import Field

from tactiled.calibrate.sections import Origin
from tactiled.live.tare import TARE_FRAMES, TARE_S
from tactiled.web.schemas import Schema, Unit


class Tare(Schema):
    """A tare that has begun."""

    frames: int = Field(description="whose mean is taken as no load, at least", examples=[TARE_FRAMES])
    seconds: float = Field(description="of frames, at least", examples=[TARE_S])


class SensorCalibration(Schema):
    """From counts to pressure: (counts - no_load) * gain."""

    calibrated: bool = Field(description="false: pressure is in counts", examples=[True])
    unit: Unit
    gain: float = Field(description="`unit` a count; negative where counts fall under pressure", examples=[0.05])
    kpa_per_count: float | None = Field(description="the same; null in counts", examples=[0.05])
    no_load: list[float] = Field(description="counts of each taxel, as last tared", examples=[[80.0, 81.5]])
    tared: int = Field(description="times since the start", examples=[0])
    load: str = Field(description='load that the newest frames show; "": none', examples=["contact of 12 kPa"])
    session: str | None = Field(description="way of the guided calibration that is open; null: none")
    tared_at: float | None = Field(
        description="Unix time of the tare that holds; null: none", examples=[1763712000.2]
    )
    can_undo: bool = Field(description="whether there is a tare to undo", examples=[False])
    id: str = Field(description="of the calibration file, or configured", examples=["3f9a0c52d1e7"])
    created: str | None = Field(description="UTC; null: no calibration file", examples=["2026-11-22T08:30:00Z"])
    sections: dict[str, Origin] = Field(description="of the calibration file: no_load, gain, cover, health")
    saturation: float | None = Field(description="counts of the ceiling; null: none", examples=[4095.0])
    noise: float = Field(description="standard deviation of a taxel, configured or measured", examples=[0.2])
    noise_kpa: float | None = Field(description="the same; null in counts", examples=[0.2])
    dead: list[int] = Field(description="taxels that do not work", examples=[[17]])
    shear_n_per_count: float | None = Field(description="null: unknown, or the skin feels no shear")


class TaxelFault(Schema):
    """A taxel found not to work."""

    taxel: int = Field(description="index", examples=[17])
    fault: Literal["stuck", "saturated", "noisy", "dead", "weak", "swapped"]
    reason: str = Field(examples=["it feels no load, and its neighbours do"])
    since: float = Field(description="timestamp of the frame", examples=[1763712000.25])


class Creep(Schema):
    """Growth of a load that stays; it is not corrected."""

    percent_per_decade: float = Field(description="for each tenfold time", examples=[4.1])
    standard_error: float = Field(examples=[0.2])
    significant: bool
    seconds: float = Field(description="that the load has stayed", examples=[600.0])
    taxels: int = Field(description="that it lies on", examples=[34])


class TaxelHealth(Schema):
    """What a sensor has found out about its taxels while it runs."""

    taxels: int = Field(examples=[1024])
    faults: list[TaxelFault] = Field(description="of taxels that do not work, without those configured as dead")
    map: str | None = Field(
        description='what of the map of taxels is wrong, or "as configured"; null: too few were pressed so far',
        examples=["taxels 40 and 77 swapped"],
    )
    noise_counts: list[float | None] = Field(
        description="standard deviation of each taxel; null: neither measured nor calibrated",
        examples=[[0.4, None]],
    )
    drift_counts: list[float] | None = Field(
        description="that each zero has moved since it was measured; null: drift is not tracked",
        examples=[[0.0, 1.2]],
    )
    drift_states: dict[str, int] | None = Field(
        description="number of taxels in each state of drift tracking", examples=[{"free": 990, "loaded": 34}]
    )
    creep: Creep | None = Field(description="of the load that lies now; null: not measured")
