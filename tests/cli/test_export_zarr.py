"""Exports as Zarr, read with zarr alone."""

import json
from contextlib import contextmanager

import numpy as np
import pytest
import zarr

from tactiled.archive import arrays
from tactiled.frames import MISSING
from tests.cli.commands import succeed
from tests.cli.recordings import FRAMES

CHUNK = 16  # frames


@contextmanager
def open_zarr(path):
    yield zarr.open_consolidated(path, mode="r")


@pytest.fixture
def exports(tmp_path, config, lossy, monkeypatch):
    """Path of an export as Zarr, in chunks of 16 frames, and the same arrays from a .npz."""
    monkeypatch.setattr(arrays, "FRAMES_AT_ONCE", CHUNK)
    with lossy.open("a") as file:
        file.write("(1600000000.7) can0 20000004#0001000000000000\n")
    for name in ("a.zarr", "a.npz"):
        succeed("export", lossy, "--config", config, "-o", tmp_path / name)
    with np.load(tmp_path / "a.npz") as npz:
        return tmp_path / "a.zarr", {**npz}


def test_it_holds_the_arrays_of_npz_in_chunks_of_frames_with_units_and_provenance(exports):
    path, npz = exports
    with open_zarr(path) as got:
        assert {*got} | {"provenance"} == {*npz}
        for name in got:
            values = got[name][:].astype(npz[name].dtype)
            assert values.tobytes() == npz[name].tobytes()
            if got[name].metadata.dimension_names[0] == "time":
                assert got[name].dtype.kind in ("T", npz[name].dtype.kind)
                assert got[name].chunks == (CHUNK, *npz[name].shape[1:])
        about = json.loads(npz["provenance"].item())
        assert dict(got.attrs) == {"provenance": about}
        assert (about["recording"]["left_out"], about["recording"]["caveats"]) == ({"error frame": 1}, [])
        units = {name: got[name].attrs["units"] for name in got if "units" in got[name].attrs}
        assert units == about["units"] == dict.fromkeys(("raw", "restored", "noise", "noise_kpa"), "kPa") | {
            "time": "seconds since 1970-01-01", "positions_mm": "mm", "cells_mm": "mm"
        }  # fmt: skip
        assert dict(got["flags"].attrs) == {
            "long_name": "what is wrong with each taxel's value: a sum of flag_masks",
            "flag_masks": [*about["flag_bits"].values()],
            "flag_meanings": "missing bad dead saturated out_of_range faulty below_zero",
        }
        assert got["loss_kind"][:].tolist() == about["loss_kinds"]
        assert got["restored"].metadata.dimension_names == ("time", "cell_row", "cell_column")
        assert got["loss"].metadata.dimension_names == ("time", "loss_kind")
        assert got["cells_mm"].metadata.dimension_names == ("cell", "axis")


def test_no_gap_is_hidden(exports):
    path, _ = exports
    with open_zarr(path) as got:
        kinds = got.attrs["provenance"]["loss_kinds"]
        lost = got["loss"][:, kinds.index("lost")]
        assert (*lost[[6, 7, 19, 20, 39, 40]], lost[-1]) == (0, 1, 1, 2, 2, 3, 3)
        missing = (got["flags"][:] & MISSING) > 0
        assert np.count_nonzero(missing[7]) == 41
        np.testing.assert_array_equal(np.isnan(got["raw"][:]), missing)
        times = [path / name / "c/1" for name in ("time", "sequence", "method")]
        for chunk in times + [path / name / "c/1/0/0" for name in ("raw", "restored", "flags")]:
            chunk.unlink()  # frames 16 to 31
        gap = slice(CHUNK, 2 * CHUNK)
        for name in ("raw", "restored", "time"):
            assert np.isnan(got[name][gap]).all()
        assert (got["flags"][gap] & MISSING).all()
        assert {*got["sequence"][gap].tolist(), *got["method"][gap].tolist()} == {-1, ""}
        complete = ~missing.any(axis=(1, 2))[2 * CHUNK : FRAMES]
        assert np.isfinite(got["restored"][2 * CHUNK : FRAMES][complete]).all()
        chunk = path / "restored/c/2/0/0"
        chunk.write_bytes(chunk.read_bytes()[:-1] + b"?")  # of the checksum
        with pytest.raises(RuntimeError, match="Zstd"):
            got["restored"][40]
