"""Sections of a calibration file made of live frames."""

import time

from tactiled.build import SensorPlan
from tactiled.calibrate import calibration_file
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.sections import Origin, Section, utc

LIVE = "live"  # the recording of frames that came from a bus


def with_sections(plan: SensorPlan, **sections: Section) -> CalibrationFile:
    """A sensor's calibration file, or a first one, with these sections."""
    return calibration_file.with_sections(plan.file, plan.name, plan.codec_name, plan.array.size, **sections)


def origin(method: str) -> Origin:
    """Of a section made now."""
    return Origin(recording=LIVE, method=method, created=utc(time.time()))
