"""Rows grow old by time that has really passed: a clock that jumps deletes nothing, and the jump is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.history.store import DAY_S, Retention, Store, connect_to_read
from rig.history.writer import Writer

NOON_S = 1_790_000_000.0 // 3600 * 3600
RETENTION = Retention(raw_days=2.0, minute_days=5.0, hour_days=10.0)
BATCH_S = 200 * 60.0  # the writer deletes after a batch of rows, and here they come as fast as it takes them
Moments = list[tuple[float, float]]  # time of day and time that has passed, s


def life(path: Path, moments: Moments) -> list[float]:
    """A daemon that writes a row at each moment; the jumps that it told of."""
    told: list[float] = []
    writer = Writer(path, lambda: Store(path, RETENTION), lambda row: None, lambda text: None, told.append)
    writer.open()
    writer.start()
    for wall_s, clock_s in moments:
        writer.row({"time_s": wall_s, "temperature_degC": 25.0}, clock_s)
    assert writer.settle(60.0)
    assert writer.failure is None
    writer.stop()
    return told


def even(begin_s: float, lasts_s: float, step_s: float, clock_s: float = 0.0, off_s: float = 0.0) -> Moments:
    """Moments of an even course; off_s: by how much the time of day is wrong."""
    count = int(lasts_s / step_s)
    return [(begin_s + off_s + k * step_s, clock_s + k * step_s) for k in range(count)]


def labels(path: Path, table: str = "raw", column: str = "time_s") -> list[float]:
    connection = connect_to_read(path)
    found = [row[0] for row in connection.execute(f"SELECT {column} FROM {table} ORDER BY {column}")]
    connection.close()
    return found


@pytest.mark.parametrize("off_days", [4000.0, -20000.0])
@pytest.mark.parametrize("restarts", [False, True])
def test_a_clock_wrong_for_75_s_deletes_nothing_and_is_told(tmp_path: Path, off_days: float, restarts: bool) -> None:
    path, off_s = tmp_path / "h.sqlite", off_days * DAY_S
    before = even(NOON_S, 1.5 * DAY_S, 60.0)
    end_s, clock_s = NOON_S + 1.5 * DAY_S, 1.5 * DAY_S
    wrong = even(end_s, 75.0, 1.0, clock_s, off_s)
    after = even(end_s + 75.0, 600.0, 1.0, clock_s + 75.0)
    if restarts:
        life(path, before)
        jumps = [*life(path, wrong), *life(path, after)]
        assert jumps[0] < 0.0  # forward the daemon may have been away; back it was not
        assert len(jumps) == 1
    else:
        jumps = life(path, [*before, *wrong, *after])
        assert jumps == [pytest.approx(off_s), pytest.approx(-off_s)]
    everything = sorted(wall_s for wall_s, _ in [*before, *wrong, *after])
    assert labels(path) == everything
    for table, width in (("minute", 60), ("hour", 3600)):  # and every row is in a roll-up
        assert labels(path, table, "start_s") == sorted({wall_s // width * width for wall_s in everything})


def test_after_a_jump_retention_goes_on_as_if_there_had_been_none(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    wrong = even(NOON_S + 6 * 3600.0, 75.0, 1.0, 6 * 3600.0, -900.0 * DAY_S)
    later = even(NOON_S + 6 * 3600.0 + 100.0, 3.0 * DAY_S, 60.0, 6 * 3600.0 + 100.0)
    life(path, [*even(NOON_S, 6 * 3600.0, 60.0), *wrong, *later])
    end_s = later[-1][0]
    assert labels(path)[0] == pytest.approx(end_s - 2.0 * DAY_S, abs=BATCH_S)
    assert labels(path, "hour", "start_s")[0] < NOON_S - 899.0 * DAY_S  # what was measured then is kept as long as all


def test_a_clock_that_stays_wrong_and_a_bench_that_was_off_age_nothing(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    wrong = even(NOON_S + 1.0 * DAY_S, 0.8 * DAY_S, 60.0, 1.0 * DAY_S, 400.0 * DAY_S)
    life(path, [*even(NOON_S, 1.0 * DAY_S, 60.0), *wrong])
    again_s = NOON_S + 900.0 * DAY_S
    assert life(path, even(again_s, 3600.0, 60.0)) == []  # forward: it was off
    assert labels(path)[0] == NOON_S
    life(path, even(again_s + 3600.0, 1.0 * DAY_S, 60.0))
    assert labels(path)[0] > NOON_S + 0.5 * DAY_S  # two days of running are kept


def test_a_jump_back_into_hours_whose_rows_are_gone_leaves_their_roll_ups(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    life(path, even(NOON_S, 4.0 * DAY_S, 60.0))
    hours = labels(path, "hour", "count")
    back = even(NOON_S + 4.0 * DAY_S, 600.0, 1.0, 4.0 * DAY_S, -3.5 * DAY_S)
    assert life(path, back) == [pytest.approx(-3.5 * DAY_S, abs=100.0)]
    assert labels(path, "hour", "count") == hours
    assert set(labels(path, "hour", "count")) == {60}


def test_a_server_that_slews_and_a_busy_computer_are_no_jump(tmp_path: Path) -> None:
    moments = [(NOON_S + 1.0005 * k + (4.0 if k % 100 == 50 else 0.0), float(k)) for k in range(2000)]
    assert life(tmp_path / "h.sqlite", moments) == []
