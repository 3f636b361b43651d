"""The EPICS server, by clients of another make: p4p on PV Access, pyepics on Channel Access."""

from __future__ import annotations

import math
import os
import pwd
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from rig.config.tables import EpicsTable
from tests.rig.daemon.benches import SERVE, RunningBench, running, until, write_current
from tests.rig.epics.servers import CaClient, PvaClient, epics_table, serving

for library in ("softioc", "p4p", "epics"):
    pytest.importorskip(library, reason=f"{library} is not installed (pip install softioc p4p pyepics)")

pytestmark = pytest.mark.usefixtures("undrawn")
NO_ALARM, MAJOR, INVALID = 0, 2, 3
OURSELVES = pwd.getpwuid(os.getuid()).pw_name
STOPPED = 2


class Rig(NamedTuple):
    bench: RunningBench
    pva: PvaClient
    ca_port: int


def rig_with(folder: Path, more: str) -> Iterator[Rig]:
    table, ca_port, pva_port = epics_table(more)
    path = write_current(folder, more=SERVE + table)
    with running(path) as bench, serving(path, bench.socket):
        client = PvaClient(pva_port)
        try:
            client.until("STATE", lambda state: state.severity != INVALID)
            yield Rig(bench, client, ca_port)
        finally:
            client.close()


@pytest.fixture(scope="module")
def read_only(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """For all three tests of it: a server takes seconds to begin. The last one stops the bench."""
    yield from rig_with(tmp_path_factory.mktemp("read_only"), "")


@pytest.fixture(scope="module")
def writable(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    yield from rig_with(
        tmp_path_factory.mktemp("writable"), f'write = true\nusers = ["{OURSELVES}"]\nhosts = ["127.0.0.1"]\n'
    )


def test_a_reading_has_its_own_time_its_unit_and_the_limits(read_only: Rig) -> None:
    bench, pva, _ = read_only
    value = pva.get("TEMPERATURE")
    row = until(
        lambda: next((r for r in list(bench.commands.recent) if abs(r["time_s"] - value.timestamp) < 1e-4), None)
    )
    assert float(value) == row["temperature_degC"]
    assert value.severity == NO_ALARM
    assert value.raw.display.units == "degC"
    low, high = bench.file.content.limits.temperature_degC
    assert (value.raw.valueAlarm.lowAlarmLimit, value.raw.valueAlarm.highAlarmLimit) == (low, high)
    assert float(pva.get("RESISTANCE")) > 0.0
    wanted = pva.get("SETPOINT")
    assert math.isnan(wanted)
    assert wanted.severity == NO_ALARM


def test_beyond_the_limits_is_a_major_alarm(read_only: Rig) -> None:
    bench, pva, _ = read_only
    row = {**bench.commands.recent[-1], "temperature_degC": 400.0, "time_s": time.time()}
    until(lambda: bench.commands.announcer.announce("row", row) or pva.get("TEMPERATURE").severity == MAJOR)


def test_stop_is_for_everybody_and_nothing_else_can_be_written(read_only: Rig) -> None:
    from p4p.client.thread import RemoteError

    bench, pva, ca_port = read_only
    job = bench.commands.submit(bench.file, "a run", None, None)
    bench.until_state("running")
    pva.until("STATE", lambda state: int(state) == 1)
    until(lambda: pva.text("JOB:ID") == job.id)
    for name in ("TEMPERATURE", "STATE", "TRIP:TEXT", "TEMPERATURE.HIHI", "STOP.DISP", "STOP.DISA", "STOP:RESULT"):
        with pytest.raises(RemoteError):
            pva.put(name, 1)
    client = CaClient(ca_port)
    try:
        for name in ("TEMPERATURE", "TEMPERATURE.HIHI", "STOP.DISP", "STOP.PROC", "STOP.ASG", "QUEUE"):
            assert not client.ask(name)["write"]
        assert not client.ask("HOLD:TEMPERATURE", wait_s=0.5)["there"]
        assert bench.state()["state"] == "running"
        assert client.ask("STOP", value=1)["fault"] is None
    finally:
        client.close()
    assert bench.state()["state"] == "stopped"  # the put that waits has been carried out
    assert bench.state()["output"] == "off"
    assert pva.text("STOP:RESULT").startswith("off, confirmed")
    assert pva.get("STOP:RESULT").severity == NO_ALARM
    pva.until("STATE", lambda state: int(state) == STOPPED)


def test_a_hold_is_started_ended_and_reset_with_a_reason(writable: Rig) -> None:
    bench, pva, _ = writable
    pva.put("HOLD:START", 1)
    assert pva.get("COMMAND:RESULT").severity == MAJOR  # no temperature was set
    pva.put("HOLD:TEMPERATURE", 40.0)
    pva.put("HOLD:DURATION", 300.0)
    pva.put("HOLD:START", 1)
    assert pva.get("COMMAND:RESULT").severity == NO_ALARM
    job = bench.commands.queue.find(pva.text("COMMAND:JOB"))
    assert job is not None
    until(lambda: job.started_s is not None or job.ended_s is not None, "the hold's beginning")
    assert job.ended_s is None, job.reason
    pva.until("COMMAND:JOB_STATE", lambda word: "".join(word) == "running")
    pva.put("COMMAND:CANCEL", 1)
    pva.until("COMMAND:JOB_STATE", lambda word: "".join(word) not in ("queued", "running"))
    pva.put("STOP", 1)
    assert bench.state()["state"] == "stopped"
    pva.put("RESET", "")
    assert bench.state()["state"] == "stopped"
    assert pva.get("COMMAND:RESULT").severity == MAJOR
    pva.put("RESET", "looked at it")
    assert bench.state()["state"] == "idle"
    pva.put("RUN:CONFIGURATION", "no such name")
    pva.put("RUN:START", 1)
    assert pva.get("COMMAND:RESULT").severity == MAJOR
    assert "no such name" in pva.text("COMMAND:RESULT")


def test_a_value_beyond_limits_is_refused_with_an_alarm_and_never_clamped(writable: Rig) -> None:
    _, pva, ca_port = writable
    pva.put("HOLD:TEMPERATURE", 40.0)
    assert (float(pva.get("HOLD:TEMPERATURE")), pva.get("HOLD:TEMPERATURE").severity) == (40.0, NO_ALARM)
    for wrong in (500.0, -500.0, math.nan, math.inf):
        pva.put("HOLD:TEMPERATURE", wrong)
        kept = pva.get("HOLD:TEMPERATURE")
        assert (float(kept), kept.severity) == (40.0, INVALID if math.isnan(wrong) else MAJOR)
    pva.put("HOLD:TEMPERATURE", 40.0)  # the old one, rightly
    assert pva.get("HOLD:TEMPERATURE").severity == NO_ALARM
    pva.put("HOLD:DURATION", 600.0)
    for wrong in (0.0, 1e9):
        pva.put("HOLD:DURATION", wrong)
        assert (float(pva.get("HOLD:DURATION")), pva.get("HOLD:DURATION").severity) == (600.0, MAJOR)
    stranger = CaClient(ca_port, "stranger")
    try:
        answer = stranger.ask("HOLD:TEMPERATURE", value=500.0)
    finally:
        stranger.close()
    assert answer["value"] == 40.0


BEGAN_BEFORE_THE_ANSWER = """
from softioc import builder
from rig.epics import records
from rig.epics.records import Published
builder.SetDeviceName("RIG")
def submitted(*asks, **body):  # the daemon's events overtake its answer
    asked.take("job", {"id": "a", "state": "running"})
    return records.Answer(True, "a hold: queued", "a")
asked = records.Commands(None, Published((0.0, 100.0), 1.0))
records.command = submitted
asked._hold(1)
print(asked._job.get(), asked._job_state.get())
asked.take("job", {"id": "another", "state": "failed"})
asked.take("job", {"id": "a", "state": "done"})
print(asked._job.get(), asked._job_state.get())
"""


def test_a_job_may_begin_before_the_answer_that_it_is_taken() -> None:
    done = subprocess.run(
        [sys.executable, "-c", BEGAN_BEFORE_THE_ANSWER], capture_output=True, text=True, check=True, timeout=180.0
    )
    assert done.stdout.splitlines() == ["a running", "a done"]


def test_who_is_not_on_the_list_cannot_write(tmp_path: Path) -> None:
    from p4p.client.thread import RemoteError

    for bench, pva, ca_port in rig_with(tmp_path, 'write = true\nusers = ["somebody_else"]\n'):
        with pytest.raises(RemoteError):
            pva.put("HOLD:TEMPERATURE", 40.0)
        client = CaClient(ca_port)
        assert not client.ask("RESET")["write"]
        client.close()
        pva.put("STOP", 1)
        assert bench.state()["state"] == "stopped"


def test_without_the_daemon_everything_is_invalid_and_stop_says_so(tmp_path: Path) -> None:
    table, _, pva_port = epics_table()
    path = write_current(tmp_path, more=SERVE + table)
    with serving(path, tmp_path / "bench.sock"):
        client = PvaClient(pva_port)
        try:
            assert client.get("TEMPERATURE").severity == INVALID
            assert math.isnan(client.get("TEMPERATURE"))
            client.put("STOP", 1)
            assert client.get("STOP:RESULT").severity == MAJOR
            assert "NOT CONFIRMED" in client.text("STOP:RESULT")
            with running(path):  # it comes later
                client.until("TEMPERATURE", lambda value: value.severity == NO_ALARM)
            client.until("STATE", lambda state: state.severity == INVALID)  # and goes
            assert client.get("TEMPERATURE").severity == INVALID
        finally:
            client.close()


def test_a_port_that_is_taken_and_a_missing_library_are_told_in_a_line(tmp_path: Path) -> None:
    table, ca_port, _ = epics_table()
    path = write_current(tmp_path, more=SERVE + table)
    words = [sys.executable, "-m", "rig", "epics", str(path)]
    with socket.create_server(("127.0.0.1", ca_port)):
        taken = subprocess.run(words, capture_output=True, text=True)
    assert (taken.returncode, taken.stderr.count("\n")) == (1, 1)
    assert f"127.0.0.1:{ca_port}" in taken.stderr
    code = f"import sys; sys.modules['softioc'] = None; from rig.__main__ import main; sys.exit(main({words[3:]!r}))"
    missing = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert missing.returncode == 2
    assert "pip install 'softioc>=4.7'" in missing.stderr
    assert missing.stderr.count("\n") == 1


def written(**more: Any) -> str:
    from rig.epics.records import access_list

    return access_list(EpicsTable(**more))


def test_the_access_list_names_who_may_write() -> None:
    assert "WRITE) {" not in written()
    both = written(write=True, users=["ada"], hosts=["10.0.0.7"])
    assert "UAG(writers) { ada }" in both
    assert "RULE(0, WRITE) { UAG(writers) HAG(consoles) }" in both
    with pytest.raises(ValueError, match="users, hosts"):
        EpicsTable(write=True)
    with pytest.raises(ValueError, match="letters"):
        EpicsTable(write=True, users=["ada } ASG(STOP) {"])
