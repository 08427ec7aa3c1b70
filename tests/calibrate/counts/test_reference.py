import numpy as np
import pytest

from tactiled.calibrate.counts.reference import Alignment, Reference, read_reference, resampled
from tactiled.errors import ConfigError

ROWS = "".join(f"{0.1 * n:.1f},x,{n}\n" for n in range(30))


def test_a_log_is_read_by_the_units_in_its_header(tmp_path):
    path = tmp_path / "f.csv"
    path.write_text("\ufefftime_s, note ,force_n\n" + ROWS)
    log = read_reference(path)
    assert (log.quantity, log.unit) == ("force_n", "N")
    np.testing.assert_allclose(log.times, 0.1 * np.arange(30))
    np.testing.assert_allclose(log.values, np.arange(30))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,n,force_lbf\n" + ROWS, "column 'force_lbf': unknown unit; use force_n or pressure_kpa"),
        ("time_s,n,Pressure (psi)\n" + ROWS, "column 'Pressure (psi)': unknown unit"),
        ("time_ms,n,force_n\n" + ROWS, "column 'time_ms': unknown unit; use time_s"),
        ("time_s,pressure_kpa,force_n\n" + ROWS, "columns force_n and pressure_kpa: give one of them"),
        ("a,b,c\n" + ROWS, "columns 'a, b, c': give time_s and force_n or pressure_kpa"),
        ("time_s,n,force_n\n0,x,1\n1,x,one\n", "line 3: '1,x,one': give numbers"),
        ("time_s,n,force_n\n0,x,1\n1\n", "line 3: '1': give numbers"),
        ("time_s,n,force_n\n0,x,nan\n", "line 2: '0,x,nan': give numbers"),
        ("time_s,n,force_n\n0,x,1\n", "1 rows: give 20 or more"),
        ("time_s,n,force_n\n" + ROWS + "1234567.5,x,5\n1234567,x,5\n", "rise at line 33: 1234567.0"),
        ("", "columns '': give time_s"),
        ("\x00\xff", "f.csv: "),
    ],
)
def test_a_log_that_cannot_be_meant_is_refused_by_its_column_or_line(tmp_path, text, message):
    path = tmp_path / "f.csv"
    path.write_text(text, "latin-1")
    with pytest.raises(ConfigError) as error:
        read_reference(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(ConfigError, match="No such file"):
        read_reference(tmp_path / "gone.csv")


def test_a_log_is_averaged_where_it_is_finer_and_interpolated_where_it_is_coarser(tmp_path):
    times = np.arange(0, 10, 0.001)
    fine = Reference(tmp_path, "force_n", times, np.sin(times) + np.where(np.arange(times.size) % 2, 1.0, -1.0))
    at = np.arange(-0.5, 10.5, 0.05)
    inside = (at > 0.1) & (at < 9.9)
    np.testing.assert_allclose(resampled(fine, at)[inside], np.sin(at[inside]), atol=2e-2)
    assert np.isnan(resampled(fine, at)[[0, -1]]).all()
    coarse = Reference(tmp_path, "force_n", times[::200], np.sin(times[::200]))
    np.testing.assert_allclose(resampled(coarse, at)[inside][:-3], np.sin(at[inside])[:-3], atol=6e-3)


@pytest.mark.parametrize(
    ("offset_s", "deviation_s", "text"),
    [
        (-1790000123.4567, 0.0012, "-1790000123.4567 s from the recording's, standard error 0.0012 s"),
        (2.34567, 0.23, "+2.35 s from"),
        (-3.0, 45.0, "-3 s from"),
        (0.5, 0.0, "+0.500000 s from the recording's, standard error 0 s"),
    ],
)
def test_a_clock_has_the_digits_that_its_error_leaves(offset_s, deviation_s, text):
    assert Alignment(offset_s, deviation_s).text.startswith(text)
