"""What whoever keeps a bench is told, and a hold that is asked for by its temperature alone."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import re
import shutil
import sys
import threading
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rig.__main__ import _notes
from rig.config.configuration import read_configuration
from rig.core.outcome import OfOutput
from rig.core.streams import MOST_WAITING, PatientLines
from rig.daemon import latch
from rig.daemon.command_queue import HISTORY
from rig.daemon.configurations import admit, hold_of
from rig.daemon.http_server import Refusal, Requests
from rig.daemon.job_run import JobRun, _end_by
from rig.daemon.status_text import progress_line, status_rows, watch_line
from rig.history.reading import loop_points
from rig.history.store import Retention, Store, connect_to_read
from tests.rig.daemon.benches import SERVE, RunningBench, running, until, write_current
from tests.rig.history.test_history import locked


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[RunningBench]:
    with running(write_current(tmp_path, more=SERVE)) as one:
        yield one


def ended_job(bench: RunningBench, number: str) -> dict[str, Any]:
    """A job when it has ended."""
    tables = bench.commands.queue.tables
    found = until(lambda: [job for job in tables() if job["id"] == number and job["ended_s"]], "the job's end")
    return dict(found[0])


def test_memory_is_known_when_conditioning_has_ended_and_not_before() -> None:
    """A conditioning comes in two phases of that name: a look at the temperature, and the way to the hot end."""
    commands = SimpleNamespace(
        memory_since_s=None, label_s=lambda: 7.0, clock=SimpleNamespace(now_s=lambda: 0.0), changed=lambda: None
    )
    own = {"_job": SimpleNamespace(phase=None), "_conditioning": False, "_coming": []}
    job = cast(JobRun, SimpleNamespace(_commands=commands, _expect=lambda phases: None, **own))
    for name, known in (("polarity", None), ("condition", None), ("condition", None), ("approach", 7.0)):
        JobRun.phase(job, name, 0.0, 1.0)
        assert commands.memory_since_s == known, name


def test_what_became_of_the_output_is_told_apart_whatever_its_words() -> None:
    error = RuntimeError("a fault")
    error.add_note("output off: so a driver of one's own may begin, too")
    error.add_note(OfOutput("nothing flows, says the controller"))
    assert _end_by(error).reason == "RuntimeError: a fault; output off: so a driver of one's own may begin, too"
    assert _notes(error).startswith("; nothing flows, says the controller; output off: so")


def test_starts_ends_stops_and_trips_are_logged(bench: RunningBench, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    monkeypatch.setattr(bench.commands, "_log", lines.append)
    answers = Requests(bench.commands)
    job = answers.answer("POST", "/api/jobs", {"configuration": "config"})[1]["id"]
    bench.until_phase("profile")
    stopped = answers.answer("POST", "/api/stop", {"by": "a test"})[1]
    assert stopped["confirmed_by"] == "its status, and the current that it measures"
    until(lambda: any(f"job {job} config (current_profile): stopped" in line for line in lines), "the job's end")
    answers.answer("POST", "/api/reset", {"reason": "looked at it"})[1]
    bench.commands.trip("a_cause", "what was wrong")
    told = [re.sub(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d ", "", line) for line in lines]
    assert all(a != b for a, b in zip(lines, told, strict=True))  # each begins with the time of day
    order = [f"job {job} config (current_profile): queued", f"job {job} config (current_profile): running"]
    assert told[0] == order[0]
    assert told[1].startswith(f"{order[1]}; ")  # and the folder in which its rows are
    stop = next(line for line in told if line.startswith("STOP by a test: output off, confirmed in"))
    reset, trip = told.index("reset: looked at it"), told.index("TRIPPED, a_cause: what was wrong")
    assert 2 <= told.index(stop) < reset < trip
    assert [output for what, output in status_rows(bench.state()) if what == "output"] == [
        "off, confirmed by the controller (its status, and the current that it measures)"
    ]
    unknown = bench.state() | {"output": "unknown", "output_confirmed": False}
    assert dict(status_rows(unknown))["output"] == "unknown, NOT CONFIRMED: switch the controller off by hand"


def test_a_job_ends_where_its_history_is_deleted_and_what_is_latched_stays(bench: RunningBench) -> None:
    text = bench.file.path.read_text()
    job = Requests(bench.commands).answer("POST", "/api/jobs", {"text": text, "name": "long"})[1]["id"]
    bench.until_phase("profile")
    shutil.rmtree(bench.commands.folder)
    ended = ended_job(bench, job)
    assert "moved or deleted" in ended["reason"]
    assert bench.until_state("tripped")["output_confirmed"] is True
    until(lambda: bench.commands.writer.failure is None, "a new history")
    until(lambda: bench.commands.latch_store.on_disk, "the latch")
    assert any("a new one was begun" in warning for warning in bench.state()["warnings"])
    kept = latch.read(bench.commands.folder / latch.LATCH)
    assert kept is not None
    assert kept.state == "tripped"
    with contextlib.closing(Store(bench.commands.folder / HISTORY, Retention())) as store:
        assert [one["id"] for one in store.jobs()] == [job]


def test_whoever_does_not_read_the_log_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    class Stalled(io.StringIO):
        def write(self, text: str) -> int:
            released.wait(10.0)
            return super().write(text)

    released, stream = threading.Event(), Stalled()
    monkeypatch.setattr(sys, "stderr", stream)
    log = PatientLines("peltier serve")
    for k in range(2 * MOST_WAITING):
        log(f"line {k}")
    released.set()
    log.close(1.0)
    lines = stream.getvalue().splitlines()
    assert lines[:2] == ["peltier serve: line 0", "peltier serve: line 1"]
    assert len(lines) <= MOST_WAITING + 2


def test_a_job_that_was_ended_has_its_report(bench: RunningBench) -> None:
    text = bench.file.path.read_text()
    job = Requests(bench.commands).answer("POST", "/api/jobs", {"text": text, "name": "long"})[1]["id"]
    bench.until_phase("profile")
    until(lambda: len(bench.commands.recent) > 5)
    bench.commands.cancel(job, "a test")
    ended = ended_job(bench, job)
    assert ended["report"] == f"/runs/{job}/report.html"
    shown = dict(status_rows(bench.state()))
    assert job in shown["last job"]
    assert shown["report"] == f"{ended['folder']}/report.html"
    assert "ended early" in (Path(ended["folder"]) / "report.html").read_text()


# -- a hold ------------------------------------------------------------------------------------------------------


def test_a_hold_is_the_benchs_own_configuration_with_another_experiment(tmp_path: Path) -> None:
    path = write_current(tmp_path, more="[serve]\nport = 0\n[control]\nms = 1.3\n")
    file = read_configuration(path)
    hold = hold_of(file, 60.5, 300, None)
    admit(hold, file, {})
    ours, theirs = hold.content.model_dump(), file.content.model_dump()
    assert ours.pop("experiment") != theirs.pop("experiment")
    assert ours == theirs
    e = hold.content.experiment
    assert (e.kind, e.law, e.target) == ("hold", "instrument_pid", ["start 60.5 degC", "hold 300.0 s"])
    assert tomllib.loads(hold.text)["experiment"]["kind"] == "hold"  # what the run folder keeps says what was done
    known = hold_of(file, 60.5, 300, tmp_path / "model.toml").content.experiment
    assert (known.model, known.law) == (str(tmp_path / "model.toml"), "full")


@pytest.mark.parametrize(
    ("question", "says"),
    [
        ({"hold_degC": 95.0}, "hold_degC: 95.0: expected a number between the bench's limits, 10 and 95"),
        ({"hold_degC": "60"}, "hold_degC: '60': expected a number"),
        ({"hold_degC": True}, "hold_degC: True: expected a number"),
        ({"hold_degC": None}, "hold_degC: None: expected a number"),
        ({"hold_degC": 60, "hold_s": 0}, "hold_s: 0: expected a number from 1 to"),
        ({"hold_degC": 60, "hold_s": 1e9}, "hold_s: 1000000000.0: expected"),
        ({"hold_degC": 60, "kind": "calibration"}, "configuration: missing"),
    ],
)
def test_a_hold_that_is_none_is_refused(tmp_path: Path, question: dict[str, Any], says: str) -> None:
    file = read_configuration(write_current(tmp_path))
    commands = SimpleNamespace(file=file, model=None, configurations=tmp_path, queue=[])
    with pytest.raises(Refusal) as refusal:
        Requests(cast(Any, commands)).answer("POST", "/api/jobs", {**question})
    assert refusal.value.status == 422
    assert says in refusal.value.lines[0]


def test_a_hold_runs_through_the_same_door(bench: RunningBench) -> None:
    job = Requests(bench.commands).answer("POST", "/api/jobs", {"hold_degC": 59.5, "hold_s": 1})[1]
    assert (job["name"], job["kind"]) == ("hold 59.5 degC", "hold")
    ended = ended_job(bench, job["id"])
    assert (ended["state"], ended["reason"]) == ("done", None)


def test_the_procedure_for_pymeasure_does_what_the_page_says(bench: RunningBench, root: Path) -> None:
    pytest.importorskip("pymeasure")
    text = (root / "docs" / "own_law.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    (block,) = [block for block in blocks if "class Staircase" in block]
    bench.serve()
    names: dict[str, Any] = {"__name__": "page"}
    exec(block.replace("http://127.0.0.1:8765", bench.url.rstrip("/")), names)
    rows: list[dict[str, float]] = []
    procedure = names["Staircase"]()
    procedure.low_degC, procedure.high_degC, procedure.steps, procedure.hold_s = 59.5, 59.0, 2, 1.0
    procedure.emit, procedure.should_stop = lambda kind, row: rows.append(row), lambda: False
    procedure.execute()
    jobs = [(job["name"], job["state"]) for job in bench.commands.queue.tables()]
    assert jobs == [("hold 59 degC", "done"), ("hold 59.5 degC", "done")]
    assert len(rows) >= 4
    # until the first hold the plate cools to its room
    assert all(20.0 < row["temperature_degC"] < 62.0 and row["resistance_ohm"] > 100.0 for row in rows)


# -- the loop ----------------------------------------------------------------------------------------------------


def test_no_line_is_drawn_over_a_gap_in_the_films_plane(tmp_path: Path) -> None:
    times = [*range(50), *range(350, 400), *range(400, 700, 10)]  # idle; a gap of 301 s; idle, then a slow run
    store = Store(tmp_path / "history.sqlite", Retention(30.0, 400.0, 4000.0))
    film = {"resistance_ohm": 1e4, "quality": "good", "phase": "idle"}
    store.add({"time_s": 1e9 + time_s, "temperature_degC": 20.0 + time_s / 10, **film} for time_s in times)
    store.close()
    for points in (1000, 20):
        found = loop_points(tmp_path / "history.sqlite", 1e9 - 1.0, points)
        gaps = [k for k, point in enumerate(found) if point[1] is None]
        assert len(gaps) == 1
        assert found[gaps[0] - 1][0] == 1e9 + 49
        assert found[gaps[0] + 1][0] == 1e9 + 350
        assert found[-1][0] == 1e9 + times[-1]
        assert len(found) <= points + 6


def test_a_memory_behind_its_rows_is_not_told_as_present(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's process is begun again after a week's run: its first questions go through the rows of the week."""
    from rig.web import app

    monkeypatch.setattr(app, "MOST_ROWS", 30)
    write_current(tmp_path)
    store = Store(tmp_path / "history.sqlite", Retention(30.0, 400.0, 4000.0))
    film = {"resistance_ohm": 1e4, "quality": "good", "phase": "track"}
    store.add({"time_s": 1e9 + k, "temperature_degC": 40.0 + 0.5 * k, **film} for k in range(70))
    store.close()
    plane = app.LoopPlane(tmp_path / "history.sqlite")
    found = [plane.document(str(tmp_path / "model.toml"), 1e9 - 1.0, [10.0, 95.0], 1e9 + 70.0) for _ in range(3)]
    assert [document["memory"] is None for document in found] == [True, True, False]
    assert found[-1]["memory"]["temperature_degC"] == 74.5


# -- words -------------------------------------------------------------------------------------------------------


def test_a_job_that_was_handed_over_is_told_in_a_line() -> None:
    row = {"time_s": 103.0, "temperature_degC": 61.234, "resistance_ohm": 12340.0, "current_A": 0.5}
    job = {"phase": "track", "elapsed_s": 310.0, "to_go_s": 60.0, "drive_unit": "A"}
    assert (
        progress_line(row, job, 100.0) == "track     5:13 of about 6:10, 0:57 to go   61.23 degC   12.34 kohm   0.50 A"
    )
    heater = progress_line(row, {**job, "drive_unit": "of full drive"}, 100.0)
    assert heater.endswith("0.500 of full drive")


def test_what_is_shown_of_an_instrument_that_says_nothing_is_told_as_old(bench: RunningBench) -> None:
    state = bench.until_state("idle")
    state["reading"] |= {"time_s": 100.0, "temperature_degC": 61.234, "quality": "good"}
    assert dict(status_rows({**state, "time_s": 101.0}))["reading"] == "good, 1 s ago"
    for word, at_s in (("idle", 108.0), ("tripped", 108.0), ("offline", 101.0)):
        then = {**state, "state": word, "time_s": at_s}
        old = f"NONE for {at_s - 100.0:.0f} s: the values shown are older"
        assert dict(status_rows(then))["reading"] == old
        assert f"reading: {old}" in watch_line(then)


def test_a_line_of_watch_has_the_time_of_day(bench: RunningBench) -> None:
    state = bench.until_state("idle")
    state["reading"] |= {"time_s": 100.0, "temperature_degC": 61.234, "resistance_ohm": 12340.0, "current_A": 0.0}
    state["time_s"] = 101.0
    day = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(101.0))
    assert watch_line(state) == f"{day} idle     -           61.234 degC  0.000 A  12.34 kohm"
    assert watch_line({**state, "output_confirmed": False}).endswith("  OUTPUT NOT CONFIRMED")


def test_the_unit_for_systemd_says_what_the_daemon_does(root: Path) -> None:
    import configparser
    import shutil
    import subprocess

    from rig.daemon.client import SYSTEM
    from rig.daemon.supervisor import JOB_ENDS_S

    text = (root / "docs" / "peltier.service").read_text()
    unit = configparser.ConfigParser(strict=False, interpolation=None, comment_prefixes=("#",))
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string(text)
    service = unit["Service"]
    assert (service["Type"], service["NotifyAccess"]) == ("notify", "all")  # the guard's child is who notifies
    program, verb, configuration = service["ExecStart"].split()
    assert (verb, service["ExecStopPost"]) == ("serve", f"{program} off {configuration}")
    assert service["SuccessExitStatus"] == str(128 + 15)
    assert Path("/run", service["RuntimeDirectory"]) == Path(SYSTEM)
    assert Path("/var/lib", service["StateDirectory"]) == Path(service["WorkingDirectory"])
    assert float(service["TimeoutStopSec"]) > JOB_ENDS_S
    assert unit["Install"]["WantedBy"] == "multi-user.target"
    if analyze := shutil.which("systemd-analyze"):
        there = root / "docs" / "peltier.service"
        copy = Path(os.environ.get("TMPDIR", "/tmp")) / f"peltier-verify-{os.getpid()}" / "peltier.service"
        copy.parent.mkdir()
        copy.write_text(there.read_text().replace(program, shutil.which("true") or "/bin/true"))
        done = subprocess.run([analyze, "verify", str(copy)], capture_output=True, text=True)
        shutil.rmtree(copy.parent)
        assert (done.returncode, done.stderr) == (0, "")


def test_a_history_that_is_locked_in_mid_run_ends_no_run(bench: RunningBench) -> None:
    """A database browser ended runs of hours after 5 s."""
    text = bench.file.path.read_text()
    with locked(bench.commands.folder / HISTORY) as let_go:
        job = Requests(bench.commands).answer("POST", "/api/jobs", {"text": text, "name": "beside a lock"})[1]["id"]
        bench.until_phase("profile")
        until(lambda: bench.commands.writer.trouble, "the lock")
        waits = "the history has to wait: "
        warnings = until(lambda: [line for line in bench.state()["warnings"] if line.startswith(waits)], "a word")
        assert "close it there" in warnings[0]
        assert bench.state()["reading"]["quality"] == "not recorded yet"
        assert bench.state()["no_job_because"] == []
        shown = lambda: sum(row.get("job") == job for row in list(bench.commands.recent))  # noqa: E731
        until(lambda: shown() > 6, "rows that are shown meanwhile")
        bench.commands.cancel(job, "a test")
        assert ended_job(bench, job)["state"] == "stopped"
        assert bench.state()["trip"] is None
        let_go()
    assert bench.commands.writer.settle()
    assert not any("history" in line for line in bench.state()["warnings"])
    with contextlib.closing(connect_to_read(bench.commands.folder / HISTORY)) as connection:
        found = connection.execute("SELECT temperature_degC FROM raw WHERE job = ? ORDER BY id", [job])
        kept = [degC for (degC,) in found]
    with (Path(ended_job(bench, job)["folder"]) / "record.csv").open() as file:
        recorded = [float(row["temperature_degC"]) for row in csv.DictReader(file)]
    assert len(recorded) > 5
    assert kept == recorded
