"""Exports for Rerun's viewer: images, contacts, series and warnings over time, with the screen to show them on."""

import json
import os
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import rerun as rr

from tactiled.archive.writers import Writer
from tactiled.build import SensorPlan
from tactiled.contacts.regions import Measures
from tactiled.frames import SensorImage
from tactiled.messages import rerun as rerun_images

COPY_BYTES = 1 << 20  # at once


class RrdWriter(Writer):
    """One .rrd file, written through a pipe: Rerun's SDK itself hangs if the disk is full."""

    def __init__(self, path: Path, plan: SensorPlan) -> None:
        pipe = path.with_name(f"{path.name}.pipe")
        os.mkfifo(pipe)
        self._file = path.open("wb")
        self._error: OSError | None = None  # after it nothing more is written
        self._copying = threading.Thread(target=self._copy, args=(pipe,), name="rrd", daemon=True)
        self._copying.start()
        self._stream = rerun_images.new_stream()
        self._stream.save(pipe, default_blueprint=rerun_images.blueprint([plan]))
        self._log = rerun_images.SensorLog(self._stream, plan)

    def _copy(self, pipe: Path) -> None:
        """Copy what comes through the pipe into the file; after an error go on without."""
        with pipe.open("rb", buffering=0) as end:
            while data := end.read(COPY_BYTES):
                try:
                    if self._error is None:
                        self._file.write(data)
                        self._file.flush()
                except OSError as error:
                    self._error = error

    def add_image(self, image: SensorImage, regions: Mapping[str, Measures]) -> None:
        """Write one image, its contacts and warnings, and what its regions hold."""
        self._log.add(image, self.contacts(image, image.time))
        self._log.add_regions(regions)

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the rest, `provenance` as a property of the recording."""
        self._stream.send_property("provenance", rr.AnyValues(json=json.dumps(provenance)))
        self.close()
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Let go of the file, complete or not."""
        self._stream.disconnect()
        self._copying.join()
        with suppress(OSError):  # is known by now
            self._file.close()
