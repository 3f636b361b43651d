"""What earlier was read wrongly without a word: times without zeros, overload as a number, half a last number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.peltier import Peltier
from tests.rig.records.reading import read, refusal

SECONDS = np.array([0.0, 1.007, 2.049, 3.090, 4.12, 5.5, 6.507])


def _stamped(pattern: str) -> str:
    rows = [f"{pattern.format(s=int(t), ms=round(1e3 * t) % 1000)}\t{20 + k}\t{1e4 - k}" for k, t in enumerate(SECONDS)]
    return "Time\tT (degC)\tR (Ohm)\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    "pattern",
    [
        "14:03:{s:02d}:{ms}",
        "14:03:{s:02d}.{ms}",
        "27.03.2026 14:03:{s:02d}:{ms}",
        "2026-03-27 14:03:{s:02d}.{ms}",
        "3/27/2026 2:03:{s:02d}.{ms} PM",
    ],
)
def test_milliseconds_without_leading_zeros(file: Path, pattern: str) -> None:
    record = read(file, _stamped(pattern))
    np.testing.assert_allclose(record["time_s"], SECONDS, atol=1e-9)
    assert "milliseconds without leading zeros" in " ".join(record.notes)


@pytest.mark.parametrize("stamp", ["14:03:{}", "2026-03-27 14:03:{}", "27.03.2026 14:03:{}"])
@pytest.mark.parametrize("written", ["{:06.3f}", "{:09.6f}", "{:05.2f}", "{:.3g}"])
def test_decimals_stay_decimals(file: Path, stamp: str, written: str) -> None:
    """With all their digits, and where the last zeros were left out."""
    seconds = np.array([10.0, 10.25, 10.5, 11.07, 11.4, 12.05, 12.35]) if written == "{:.3g}" else 10.0 + SECONDS
    rows = [f"{stamp.format(written.format(s))}\t{20 + k}\t{1e4 - k}" for k, s in enumerate(seconds)]
    record = read(file, "Time\tT (degC)\tR (Ohm)\n" + "\n".join(rows) + "\n")
    expected = [float(written.format(s)) - float(written.format(seconds[0])) for s in seconds]
    np.testing.assert_allclose(record["time_s"], expected, atol=1e-9)
    assert "leading zeros" not in " ".join(record.notes)


@pytest.mark.parametrize(
    ("head", "written", "factor"), [("R (Ohm)", "+1.00000E+9", 1.0), ("R (kOhm)", "9.99999E+06", 1e-3)]
)
def test_overload_that_was_written_as_a_number(file: Path, head: str, written: str, factor: float) -> None:
    ohm = np.linspace(1e5, 200.0, 40)
    rows = [f"{k},{30 + k},{written if k < 6 else ohm[k] * factor}" for k in range(40)]
    record = read(file, f"t (s),T (degC),{head}\n" + "\n".join(rows) + "\n")
    assert np.isinf(record["resistance_ohm"][:6]).all()
    np.testing.assert_allclose(record["resistance_ohm"][6:], ohm[6:])
    assert "as beyond the range (6 rows)" in " ".join(record.notes)


@pytest.mark.parametrize("most", ["1234567000", "1.1E9"])
def test_a_resistance_of_a_gigaohm_is_one(file: Path, most: str) -> None:
    """And one of exactly so many, where the readings lead up to it."""
    rows = [f"{k},{30 + k},{most if k < 6 else 1e6 / (k + 1)}" for k in range(40)]
    assert np.isfinite(read(file, "t (s),T (degC),R (Ohm)\n" + "\n".join(rows) + "\n")["resistance_ohm"]).all()
    rows = [f"{k},{30 + k},{10.0 ** (9 - k / 10)!r}" for k in range(40)]
    assert np.isfinite(read(file, "t (s),T (degC),R (Ohm)\n" + "\n".join(rows) + "\n")["resistance_ohm"]).all()


@pytest.mark.parametrize("more", ["", ",,heating"])
@pytest.mark.parametrize("count", [40, 1400])
def test_a_last_number_of_which_half_was_written(file: Path, count: int, more: str) -> None:
    rows = [f"{k},{30 + k / 100:.2f},{1e4 + k:.3f}{more.replace(',,', ',')}" for k in range(count)]
    text = f"t (s),T (degC),R (Ohm){',phase' if more else ''}\n" + "\n".join(rows)
    assert read(file, text).rows == count  # no end behind the last line is no fault
    if more:
        return
    record = read(file, text[:-5])
    assert record.rows == count - 1
    assert f"line {count + 1} left out, it may have been cut off" in " ".join(record.notes)
    assert read(file, text[:-5] + "\n").rows == count  # its end says that it is whole


def test_a_second_sweep_in_one_file_is_told_as_that(file: Path) -> None:
    sweep = "".join(f"{k},{300 + k},{1e4 - k}\n" for k in range(30))
    other = sweep.replace(",30", ",31")
    said = refusal(file, f"t (s),T (K),R (Ohm)\n{sweep}\n{other}")
    assert "line 33: time_s: 0.0 after 29.0: expected increasing times; it starts again, as in another sweep" in said
    wrong = sweep.replace("\n20,", "\n2,")
    assert "another sweep" not in refusal(file, f"t (s),T (K),R (Ohm)\n{wrong}")


def test_a_file_with_the_newest_row_first_is_told_as_that(file: Path) -> None:
    rows = "".join(f"{k},{300 + k % 7},{1e4 - k % 5}\n" for k in reversed(range(30)))
    said = refusal(file, f"t (s),T (K),R (Ohm)\n{rows}")
    assert "time_s: falls in every row; expected increasing times, or --reversed: the last row was taken first" in said
    assert "another sweep" not in said


@pytest.mark.parametrize("verb", ["identify", "diagnose"])
def test_a_current_that_is_written_only_where_it_changes(tmp_path: Path, peltier: Peltier, verb: str) -> None:
    """As merged cells of a workbook are, too. "max() arg is an empty sequence" was all that a diagnosis said."""
    path = tmp_path / "a.csv"
    rows = [f"{k},{25 + 0.1 * k},{0.5 if k % 20 == 0 else ''}" for k in range(100)]
    path.write_text("\n".join(["time_s,temperature_degC,current_A", *rows]) + "\n")
    err = peltier.fails(verb, path)
    expected = "stands in 5 of 100 rows, nowhere in three one after the other; expected in each: fill it down"
    assert err.startswith(f"{path}: current_A: {expected}")
