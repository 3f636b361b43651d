"""A row of the history beside that of the job's own record."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rig.config.configuration import read_configuration
from rig.history.store import connect_to_read
from rig.records.record_file import read_record
from tests.rig.daemon.benches import SERVE, running, until, write_current

THROUGH_THE_RANGES = '["start 0.5 A", "hold 2 s", "ramp to 3 A in 20 s", "hold 10 s"]'


def test_the_test_current_is_that_of_the_rows_own_reading(tmp_path: Path) -> None:
    """Though the next reading, in another range maybe, has been begun when the row is written."""
    path = write_current(tmp_path, THROUGH_THE_RANGES, more=SERVE)
    with running(path) as bench:
        job = bench.commands.submit(read_configuration(path))
        until(lambda: job.ended_s is not None, "the job's end")
        assert job.state == "done", job.reason
        assert job.folder is not None
        bench.commands.writer.settle()
        with connect_to_read(bench.commands.folder / "history.sqlite") as connection:
            kept = connection.execute("SELECT resistance_ohm, meter_current_A FROM raw").fetchall()
        record = read_record(job.folder / "record.csv")
    in_history = dict(kept)
    rows = np.flatnonzero(np.diff(record["meter_current_A"]) != 0.0)
    assert rows.size
    for row in (*rows, *(rows + 1)):
        ohm = record["resistance_ohm"][row]
        if np.isfinite(ohm):
            assert in_history[ohm] == record["meter_current_A"][row]


def test_the_first_reading_after_a_job_is_there(tmp_path: Path) -> None:
    """The job has asked for one more than it took: the next question would be out of step with its answer."""
    path = write_current(tmp_path, '["start 0.5 A", "hold 2 s"]', more=SERVE)
    with running(path) as bench:
        job = bench.commands.submit(read_configuration(path))
        until(lambda: job.ended_s is not None, "the job's end")
        assert job.state == "done", job.reason
        until(
            lambda: bench.commands.recent and bench.commands.recent[-1]["time_s"] > job.ended_s + 1.0, "rows after it"
        )
        rows = [row for row in bench.commands.recent if row["time_s"] > job.ended_s - 1.0]
    assert [row["quality"] for row in rows if row["quality"] != "good"] == []
