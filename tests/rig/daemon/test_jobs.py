"""Jobs on the bench: queue, stop, trip and reset, what is kept of them; rows, gaps and jumps of the clock."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import rig.daemon.job_run
import rig.daemon.supervisor
from rig.config.configuration import read_configuration
from rig.control.decision import Tick, Ticks
from rig.core.errors import Disconnected
from rig.core.faults import Faults
from rig.core.outcome import NotConfirmedOff
from rig.core.reading import Identity, Reading
from rig.daemon.command_queue import Gaps
from rig.daemon.configurations import admit, by_text
from rig.daemon.http_server import Refusal, Requests
from rig.daemon.job_run import JobRun
from rig.daemon.status_text import status_rows
from rig.drivers.controller import TemperatureController
from rig.experiment.feasibility import still_to_come
from rig.history import reading
from rig.ports.protocol_sim import unregister
from rig.records.run_folder import part_of
from tests.rig.daemon.benches import LONGEST_S, SERVE, RunningBench, running, until, write_current

SHORT = '["start 0 A", "hold 0.2 s"]'


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[RunningBench]:
    with running(write_current(tmp_path, more=SERVE)) as bench:
        yield bench


def submit(bench: RunningBench, target: str, name: str) -> str:
    path = write_current(bench.file.path.parent, target, name, more=SERVE)
    return bench.commands.submit(read_configuration(path), name).id


def table(bench: RunningBench, number: str) -> dict[str, object]:
    return next(job for job in bench.commands.queue.tables() if job["id"] == number)


def test_a_daemon_starts_with_the_output_off_and_nothing_running(bench: RunningBench) -> None:
    state = bench.state()
    assert (state["state"], state["output"], state["output_confirmed"]) == ("idle", "off", True)
    assert state["job"] is None
    assert state["memory_known"] is False
    assert state["reading"]["quality"] == "good"
    assert "Meerstetter" in state["instruments"]["controller"]
    assert any("real time" in line for line in state["warnings"])  # the configuration asks for virtual time


def test_jobs_run_one_after_another_and_leave_run_folders(bench: RunningBench) -> None:
    first, second = submit(bench, SHORT, "one"), submit(bench, SHORT, "two")
    until(lambda: table(bench, second)["state"] == "done", "the second job")
    one, two = table(bench, first), table(bench, second)
    assert one["state"] == "done"
    assert float(one["ended_s"]) <= float(two["started_s"])  # type: ignore[arg-type]
    folder = Path(str(two["folder"]))
    document = json.loads((folder / "run.json").read_text())
    assert document["stop"]["output_off_confirmed"] is True
    assert two["report"] == f"/runs/{second}/report.html"
    bench.commands.writer.settle()
    phases = {row["phase"] for row in list(bench.commands.recent)}
    assert {"idle", "profile"} <= phases
    until(lambda: bench.state()["state"] == "idle")


def test_a_job_tells_how_long_all_of_it_will_take(bench: RunningBench) -> None:
    number = submit(bench, '["start 0 A", "hold 300 s"]', "long")
    until(lambda: (bench.state()["job"] or {}).get("phase") == "profile", "the profile")
    job = bench.state()["job"]
    assert job["total_s"] == pytest.approx(300.0)
    assert job["to_go_s"] == pytest.approx(job["total_s"] - job["done_s"])
    assert job["elapsed_s"] > job["done_s"]
    bench.commands.queue.running.coming_s = 100.0  # type: ignore[union-attr]  # as if something were to follow
    job = bench.state()["job"]
    assert job["to_go_s"] == pytest.approx(job["total_s"] - job["done_s"] + 100.0)
    phases = [("polarity", 5.0), ("approach", 10.0), ("track", 60.0)]
    assert still_to_come(phases, "approach") == [("track", 60.0)]
    assert still_to_come(phases, "pulse") == phases
    bench.commands.cancel(number, "the test")


def test_stop_ends_the_job_and_what_waits_and_needs_a_reset_with_a_reason(bench: RunningBench) -> None:
    running_job, waiting = submit(bench, '["start 0.5 A", "hold 60 s"]', "long"), submit(bench, SHORT, "next")
    bench.until_phase("profile")
    assert bench.state()["output"] == "on"
    off = bench.commands.stop("a test")
    assert off.confirmed
    state = bench.until_state("stopped")
    assert (state["output"], state["trip"]) == ("off", None)
    until(lambda: table(bench, running_job)["state"] == "stopped", "the job's end")
    assert "a test" in str(table(bench, running_job)["reason"])
    assert table(bench, waiting)["state"] == "stopped"  # nobody expects a heater to go on with what was stopped
    assert "submit it again" in str(table(bench, waiting)["reason"])
    later = submit(bench, SHORT, "later")
    answers = Requests(bench.commands)
    for reason in ("", "   "):
        with pytest.raises(Refusal) as refusal:
            answers.answer("POST", "/api/reset", {"reason": reason})
        assert refusal.value.status == 422
    assert answers.answer("POST", "/api/reset", {"reason": "looked at it"})[1]["queue"] == 1
    until(lambda: table(bench, later)["state"] == "done", "what was asked for after the stop")
    assert table(bench, waiting)["started_s"] is None
    with pytest.raises(Refusal) as refusal:
        answers.answer("POST", "/api/reset", {"reason": "again"})
    assert refusal.value.status == 409


def test_a_stopped_run_says_so_in_its_folder_and_idle_readings_go_on(bench: RunningBench) -> None:
    """Though the meter had been asked for a reading: with this period it is asked again as soon as it has answered."""

    def idle() -> list[str]:
        bench.commands.writer.settle()
        return [str(row["quality"]) for row in list(bench.commands.recent) if row["phase"] == "idle"]

    number = submit(bench, '["start 0.5 A", "hold 60 s"]', "long")
    bench.until_phase("profile")
    before = len(idle())
    bench.commands.stop("a test")
    until(lambda: table(bench, number)["state"] == "stopped", "the job's end")
    document = json.loads((Path(str(table(bench, number)["folder"])) / "run.json").read_text())
    assert "a test" in document["stop"]["text"]
    assert document["stop"]["output_off_confirmed"] is True
    until(lambda: len(idle()) > before + 2, "idle readings")
    assert "missing" not in idle()[before:]


def test_a_trip_latches_with_cause_and_rows_and_survives_a_restart(tmp_path: Path) -> None:
    path = write_current(tmp_path, more=SERVE)
    path.write_text(path.read_text().replace("[10, 95]", "[10, 61.5]"))
    with running(path) as bench:
        text = path.read_text().replace('["start 0 A", "hold 60 s"]', '["start 3 A", "hold 60 s"]')
        number = bench.commands.submit(by_text(text, "hot", tmp_path), "hot").id
        state = bench.until_state("tripped")
        assert state["trip"]["cause"] == "temperature_limit"
        assert state["trip"]["rows"] >= 10
        assert (state["output"], state["output_confirmed"]) == ("off", True)
        job = until(lambda: table(bench, number)["ended_s"] and table(bench, number))
        assert (job["state"], job["exit_status"]) == ("tripped", 10)
        waiting = submit_text(bench, text)
        until(lambda: len(bench.commands.recent) > 60)
        assert table(bench, waiting)["state"] == "queued"
        bench.commands.writer.settle()
    with running(path) as bench:
        state = bench.state()
        assert (state["state"], state["queue"]) == ("tripped", 0)
        assert "nothing resumes" in str(table(bench, waiting)["reason"])
        assert bench.commands.reset("the limit was meant to be 61.5 degC")
        bench.commands.writer.settle()
        kept = reading.trips(bench.commands.folder / "history.sqlite")[0]
        assert kept["cleared_because"].startswith("the limit")
        assert max(row["temperature_degC"] for row in kept["rows"]) > 61.0  # it cools down from there
    with running(path) as bench:
        assert bench.state()["state"] == "idle"


def submit_text(bench: RunningBench, text: str) -> str:
    return bench.commands.submit(by_text(text, "more", bench.commands.configurations), "more").id


def unplugged(bench: RunningBench) -> TemperatureController:
    """The controller, whose port is gone; another one is opened in its place."""
    controller = bench.commands.output_lock._controller
    assert controller is not None
    unregister(controller.transport.port.portstr.removeprefix("sim://"))  # type: ignore[attr-defined]
    return controller


def until_plugged_in(bench: RunningBench, before: TemperatureController) -> None:
    until(
        lambda: bench.commands.online and bench.commands.output_lock._controller not in (before, None),
        "the instruments",
    )


def test_lost_instruments_end_the_job_and_come_back_off(bench: RunningBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.daemon.supervisor.TRY_AGAIN_S", 0.05)
    number = submit(bench, '["start 0.5 A", "hold 60 s"]', "long")
    bench.until_phase("profile")
    controller = unplugged(bench)
    until(lambda: bench.state()["trip"], "the trip")
    assert bench.state()["trip"]["cause"] in ("not_confirmed_off", "disconnected")
    assert table(bench, number)["exit_status"] in (1, 11)
    assert bench.state()["memory_known"] is False
    until_plugged_in(bench, controller)
    assert (bench.state()["output"], bench.state()["state"]) == ("off", "tripped")
    bench.commands.reset("plugged in again")
    bench.until_state("idle")


def test_a_job_whose_instruments_are_lost_never_heats(bench: RunningBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is over, and tripped, before they are back; another one runs when its thread awakes, and is not disturbed."""
    monkeypatch.setattr("rig.daemon.supervisor.TRY_AGAIN_S", 0.05)
    monkeypatch.setattr("rig.daemon.supervisor.JOB_ENDS_S", 0.2)
    computes, computed, ended = threading.Event(), threading.Event(), threading.Event()
    whole = rig.daemon.job_run.run_on

    def run_on(*args: Any) -> Any:
        if computes.is_set():
            return whole(*args)
        computes.set()
        computed.wait(LONGEST_S)
        try:
            return whole(*args)
        finally:
            ended.set()

    monkeypatch.setattr("rig.daemon.job_run.run_on", run_on)
    slow = submit(bench, '["start 0.5 A", "hold 60 s"]', "slow")
    until(computes.is_set, "the job")
    controller = unplugged(bench)
    until(lambda: bench.state()["trip"], "the trip")
    assert table(bench, slow)["state"] == "failed"
    until_plugged_in(bench, controller)
    bench.commands.reset("plugged in again")
    bench.until_state("idle")
    assert bench.state()["output"] == "off"
    second = submit(bench, '["start 0.5 A", "hold 60 s"]', "second")
    bench.until_phase("profile")
    told = table(bench, slow)
    computed.set()
    until(ended.is_set, "the slow thread")
    assert table(bench, slow) == told
    state = bench.state()
    assert (state["state"], state["output"], state["job"]["id"]) == ("running", "on", second)
    rows = len(bench.commands.recent)
    until(lambda: len(bench.commands.recent) > rows or table(bench, second)["state"] != "running", "another row")
    assert table(bench, second)["state"] == "running"
    assert bench.state()["trip"] is None
    bench.commands.cancel(second, "the test")


def test_a_job_that_is_ended_without_its_thread_leaves_the_bench_to_the_idle_loop(bench: RunningBench) -> None:
    number = submit(bench, '["start 0.5 A", "hold 60 s"]', "long")
    bench.until_phase("profile")
    running_now = bench.supervisor._running
    assert running_now is not None
    running_now.abandon(Disconnected("gone"), off_confirmed=False)
    assert table(bench, number)["state"] == "failed"
    assert bench.state()["trip"]["cause"] == "disconnected"
    until(lambda: (bench.state()["output"], bench.state()["output_confirmed"]) == ("off", True), "the idle loop's off")
    until(lambda: bench.supervisor._running is None, "the thread's end")
    assert table(bench, number)["reason"] == "gone"
    bench.commands.reset("looked at")
    bench.until_state("idle")


def test_an_unconfirmed_off_is_told_before_drawing(bench: RunningBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever waits at `peltier run` has to go and switch off by hand: drawing takes seconds to minutes."""
    draws, drawn = threading.Event(), threading.Event()

    def run_on(session: Any, path: Path, *_: Any) -> Any:
        (part_of(path) / "record.csv").write_text("time_s\n")
        raise NotConfirmedOff("a test's port: it is on")

    def write_missing_reports(part: Path) -> None:
        draws.set()
        drawn.wait(LONGEST_S)
        (part / "report.html").write_text("a report")

    monkeypatch.setattr("rig.daemon.job_run.run_on", run_on)
    monkeypatch.setattr("rig.daemon.job_run.write_missing_reports", write_missing_reports)
    number = submit(bench, SHORT, "hot")
    until(draws.is_set, "the report")
    try:
        told = table(bench, number)
        assert (told["state"], told["exit_status"], told["report"]) == ("tripped", 11, None)
    finally:
        drawn.set()
    until(lambda: table(bench, number)["report"] == f"/runs/{number}/report.html", "what is told of the report")


def test_another_instrument_on_the_cable_is_waited_out(bench: RunningBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the one that the configuration names: the daemon says so, and goes on when the right one is back."""
    monkeypatch.setattr("rig.daemon.supervisor.TRY_AGAIN_S", 0.05)
    whole, another = rig.daemon.supervisor.open_bench, threading.Event()

    def open_bench(*args: Any) -> Any:
        if another.is_set():
            raise Faults(["bench.controller.serial_number: 113 answers"])
        return whole(*args)

    monkeypatch.setattr("rig.daemon.supervisor.open_bench", open_bench)
    another.set()
    unplugged(bench)
    until(lambda: "113 answers" in bench.commands.offline_because, "the fault")
    another.clear()
    until(lambda: bench.commands.online, "the instruments")
    bench.until_state("idle")
    lost, found = (line.split(" ", 2)[2] for line in bench.logged)  # after the time of day
    assert lost.startswith("offline, tried again every 0.05 s: ")
    assert found == "the bench is held again, the output is off"


def unrecorded(state: dict[str, Any]) -> bool:
    """Whether the bench shows a reading that its history could not take, and says so."""
    said = any("cannot be written" in line for line in state["warnings"])
    return said and state["reading"]["quality"] == "not recorded"


def make_room(bench: RunningBench) -> None:
    """At once: other work would wait behind the rows."""
    store = bench.commands.writer.store
    assert store is not None
    store.limit_size(1_000_000)


def test_a_full_disk_switches_off_first_and_shows_nothing_that_is_not_committed(bench: RunningBench) -> None:
    seen = bench.commands.announcer.listen()
    number = submit(bench, '["start 0.5 A", "hold 60 s"]', "long")
    bench.until_phase("profile")
    bench.commands.writer.do(lambda store: store.limit_size(1))
    until(lambda: table(bench, number)["ended_s"], "the job's end")
    state = bench.state()
    assert (table(bench, number)["state"], state["state"], state["output"]) == ("tripped", "tripped", "off")
    assert state["trip"]["cause"] == "history"
    # a row that is short enough for the last page may still have found room in between
    until(lambda: unrecorded(bench.state()), "the warning")
    make_room(bench)
    until(lambda: bench.commands.writer.failure is None, "room on the disk")
    bench.commands.writer.settle()
    shown = set()
    while not seen.empty():
        name, _, data = (seen.get_nowait() or b"").partition(b"\ndata: ")
        if name == b"event: row":
            shown.add(json.loads(data)["time_s"])
    kept = reading.span(bench.commands.folder / "history.sqlite", 0.0, 4e9, 5000)["time_s"]
    assert shown <= set(kept)
    assert bench.commands.writer.dropped == 0


def test_what_may_not_run_on_this_bench_is_refused_with_a_line_each(tmp_path: Path) -> None:
    bench = read_configuration(write_current(tmp_path, more=SERVE))
    text, there = bench.text, {"controller": Identity("Meerstetter", "TEC-1091", "112", "5.30")}
    for old, new, place in (
        ('driver = "meerstetter"', 'driver = "srs_ldc500"', "bench.controller.driver"),
        ("[10, 95]", "[10, 99]", "limits.temperature_degC"),
        ("current_A = 4.0", "current_A = 5.0", "limits.current_A"),
        ('port = "sim://"', 'port = "/dev/null"', "sim://"),
        (
            'port = "sim://"',
            'port = "sim://"\nserial_number = "113"',
            "bench.controller.serial_number: '113': what answers",
        ),
    ):
        with pytest.raises(Faults) as faults:
            admit(by_text(text.replace(old, new, 1), "job", tmp_path), bench, there)
        assert any(place in line for line in faults.value.lines), faults.value.lines
    admit(bench, bench, there)
    for path in ("/etc/passwd", "../secret.csv"):
        with pytest.raises(Faults, match="without a path"):
            by_text(text.replace('["start 0 A", "hold 60 s"]', f'"{path}"'), "job", tmp_path)


def test_a_job_sent_as_text_runs_no_code_of_its_sender(tmp_path: Path) -> None:
    driver = '[bench.controller]\ndriver = "mine.py:Mine"\nport = "sim://"\n'
    with pytest.raises(Faults, match=r"bench\.controller\.driver: names Python code"):
        by_text(driver, "job", tmp_path)
    with pytest.raises(Faults, match=r"simulation\.effect_files: names Python code"):
        by_text('[simulation]\neffect_files = ["mine.py"]\n', "job", tmp_path)


def test_the_test_current_is_that_of_the_rows_own_reading() -> None:
    """Though the next reading, in another range maybe, has been begun when the row is written."""
    rows: list[dict[str, Any]] = []
    commands = SimpleNamespace(label_s=lambda: 7.0, ticks=Ticks(), row=rows.append)
    valid, clock = SimpleNamespace(check_void=lambda: None), SimpleNamespace(latest_s=0.0)
    job = SimpleNamespace(_commands=commands, _pass=valid, _clock=clock, _job=SimpleNamespace(id="1"), _last=None)
    wanted = dict.fromkeys(("setpoint_degC", "reference_degC", "target_ohm", "predicted_ohm"), 1.0)
    decision = SimpleNamespace(done=False, **wanted)
    readings = {"temperature": Reading(60.0, 0.0), "resistance": Reading(1e4, 0.0), "test_current_A": 1e-4}
    tick = SimpleNamespace(decision=decision, current_A=1.5, watch=None, phase="profile", **readings)
    JobRun.tick(cast(JobRun, job), cast(Tick, tick))
    assert (rows[0]["resistance_ohm"], rows[0]["meter_current_A"], rows[0]["job"]) == (1e4, 1e-4, "1")


def test_gaps_are_counted() -> None:
    gaps = Gaps(100.0)
    for now_s in (100.1, 101.0, 131.0, 132.0, 142.0):
        gaps.cycle(now_s, 3.0)
    assert gaps.table() == {"count": 2, "longest_s": 30.0, "total_s": 40.0}


def test_a_jump_of_the_clock_and_a_gap_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(write_current(tmp_path, more=SERVE)) as bench:
        logged: list[str] = []
        bench.commands._log = logged.append
        uptime_s, real = bench.state()["uptime_s"], time.time
        monkeypatch.setattr("rig.daemon.command_queue.time.time", lambda: real() + 400 * 86400.0)
        until(lambda: any("jumped" in line for line in bench.state()["warnings"]), "the warning")
        assert "jumped forward by 400.0 days" in logged[0]
        assert bench.state()["uptime_s"] < uptime_s + 3600.0
        monkeypatch.undo()
        until(lambda: any("jumped back by 400.0 days" in line for line in bench.state()["warnings"]), "the way back")
        gaps = bench.state()["gaps"]["count"]
        bench.commands.gaps.cycle(bench.commands.clock.now_s() + 35.0, 3.0)
        assert bench.state()["gaps"]["count"] == gaps + 1
        told = dict(status_rows(bench.state()))
        assert "the longest 3" in told["gaps"]
