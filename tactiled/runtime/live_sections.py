"""Sections of a calibration file made of live frames."""

from datetime import UTC, datetime

from tactiled.build import SensorPlan
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.sections import Origin, Section, build

LIVE = "live"  # the recording of frames that came from a bus


def with_sections(plan: SensorPlan, **sections: Section) -> CalibrationFile:
    """A sensor's calibration file, or a first one, with these sections."""
    if plan.file is not None:
        return plan.file.replaced(**sections)
    return build(CalibrationFile, sensor=plan.name, codec=plan.codec_name, taxels=plan.array.size, **sections)


def origin(method: str) -> Origin:
    """Of a section made now."""
    return Origin(recording=LIVE, method=method, created=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}")
