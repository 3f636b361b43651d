"""The guard process: whatever the process that holds the port dies of, the output is off and it is said so; and a guard
that does not read holds up no loop."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks._killed_run import KilledRuns
from benchmarks.disobedient import PULSE_SHARE
from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.guard import pipe as guard_line
from rig.guard.pipe import ALIVE, GuardGone, GuardPipe, is_suspended
from rig.guard.process import has_real_ports
from rig.guard.takeover import end_trying
from rig.ports.open import holder
from rig.ports.pseudo_terminal import PseudoTerminals
from tests.rig.drivers.disobedient import Disobedient
from tests.rig.small import write_bench

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the guard needs fork")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KilledRuns]:
    with KilledRuns(tmp_path_factory.mktemp("guard"), "meerstetter") as runs:
        yield runs


def test_the_output_is_off_when_the_process_is_killed(runs: KilledRuns) -> None:
    killed = runs.kill(0.05, signal.SIGKILL)
    assert killed.off_at_the_end
    assert killed.status == 128 + signal.SIGKILL
    # no pulse, no model: the confirmation rests on what the controller says, and nobody waits
    assert "output off, confirmed by the controller (its status, and the current that it measures)" in killed.err
    assert "temperature" not in killed.err
    assert "died of SIGKILL" in killed.err
    assert f"what was recorded is in {runs.path.parent.absolute()}" in killed.err
    assert "report.html" in killed.err


def fill_stderr(process: subprocess.Popen[str]) -> None:
    """As a `less` that waits, or Ctrl-S, does: no byte more fits."""
    descriptor = os.open(f"/proc/{process.pid}/fd/2", os.O_WRONLY | os.O_NONBLOCK)
    try:
        for size in (4096, 1):
            with contextlib.suppress(BlockingIOError):
                while True:
                    os.write(descriptor, b"x" * size)
    finally:
        os.close(descriptor)


@pytest.mark.skipif(sys.platform != "linux", reason="another process's stderr is opened through /proc")
def test_whoever_does_not_read_stderr_holds_up_no_guard(runs: KilledRuns) -> None:
    """A run is suspended; the output is commanded off before anybody has been told."""
    process = runs.start()
    fill_stderr(process)
    pid, _ = holder(runs.port)
    assert pid is not None
    runs.witness.told_s.clear()
    os.kill(pid, signal.SIGSTOP)
    until_s = time.monotonic() + 20.0
    while (runs.witness.on or not runs.witness.told_s) and time.monotonic() < until_s:
        time.sleep(0.01)
    assert runs.witness.told_s  # not by the instrument's own dead man
    assert not runs.witness.on
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 128 + signal.SIGKILL
    assert "was suspended" in err
    assert "output off, confirmed by the controller" in err


def is_known(folder: Path, driver: str) -> bool:
    """Whether the run has driven a plate that it knows for 100 ticks; or has held its setpoint for 20."""
    record = next(folder.glob("run*.part/record.csv"), None)
    lines = record.read_text().splitlines() if record is not None else []
    rows = [row for row in csv.DictReader(lines) if row["phase"] == "profile"][:-1]  # the last may be cut off
    if driver == "meerstetter":
        return len(rows) >= 100
    held = [abs(float(row["temperature_degC"] or "nan") - 45.0) < 0.9 for row in rows[-20:]]
    return len(held) == 20 and all(held)


@pytest.mark.parametrize(
    ("driver", "lies"),
    [
        ("meerstetter", True),
        pytest.param("meerstetter", False, marks=pytest.mark.long),
        pytest.param("te_technology", True, marks=pytest.mark.long),
    ],
)
def test_the_temperature_is_asked_after_a_kill(tmp_path: Path, driver: str, lies: bool) -> None:
    """A controller that says "off" and is not; and one that is. The plate is the working process's knowledge."""
    made: list[Disobedient] = []

    def wrapped(controller: Any) -> Disobedient:
        made.append(Disobedient(controller, "lying"))
        return made[0]

    with KilledRuns(tmp_path, driver, wrapped, PULSE_SHARE) as runs:
        name = f'driver = "{driver}"'  # its own dead man would end a lie after 5 s
        runs.path.write_text(runs.path.read_text().replace(name, f"{name}\ndead_man_s = 60.0"))
        process = runs.start()
        pid, _ = holder(runs.port)
        assert pid is not None
        until_s = time.monotonic() + 300.0
        while not is_known(tmp_path, driver):
            assert process.poll() is None
            assert time.monotonic() < until_s
            time.sleep(0.2)
        if lies:
            made[0].begin()
        os.kill(pid, signal.SIGKILL)
        _, err = process.communicate(timeout=120.0)
        end_trying(holder(runs.port)[0])
    stop = json.loads(next(tmp_path.glob("run*.part/run.json")).read_text())["stop"]
    assert "output off, confirmed by the controller" in err  # at once, by what the controller says
    assert stop["reason"] == "process_died"
    assert stop["output_off_confirmed"] is not lies, err
    if lies:
        assert process.returncode == 11
        assert "OUTPUT NOT CONFIRMED OFF" in err
        assert "without a current" in err
        assert "without a current" in stop["text"]
    else:
        assert process.returncode == 128 + signal.SIGKILL
        assert "NOT CONFIRMED" not in err
        assert "the temperature agrees" in err


def test_one_writer_and_signals_across_the_guard(runs: KilledRuns) -> None:
    """A second run is told the process that holds the port; SIGTERM to the guard ends the first with the output off."""
    process = runs.start()
    pid, _ = holder(runs.port)
    second = subprocess.run(
        [sys.executable, "-m", "rig", "run", str(runs.path), "--out", str(runs.path.parent / "second")],
        capture_output=True,
        text=True,
    )
    assert second.returncode == 75
    assert f"process {pid}" in second.stderr
    assert "peltier guard" not in second.stderr  # the output is the first one's business
    assert runs.witness.on
    off = subprocess.run([sys.executable, "-m", "rig", "off", str(runs.path)], capture_output=True, text=True)
    assert off.returncode == 75
    assert f"the output may be on: `kill {pid}`" in off.stderr
    assert runs.witness.on
    process.terminate()
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 128 + signal.SIGTERM
    assert "stopped by SIGTERM; output off, confirmed by the controller" in err
    assert not runs.witness.on


def test_the_guard_dies(runs: KilledRuns) -> None:
    process = runs.start()
    pid, _ = holder(runs.port)
    assert pid is not None
    process.kill()
    process.wait()
    until_s = time.monotonic() + 60.0
    while holder(runs.port)[0] == pid and time.monotonic() < until_s:
        time.sleep(0.01)
    assert not runs.witness.on
    assert holder(runs.port)[0] is None
    _, err = process.communicate()
    assert f"the guard process {process.pid} has died" in err


def test_the_guard_of_a_daemon_dies(runs: KilledRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PELTIER_SOCKET", str(tmp_path / "bench.sock"))
    path = tmp_path / "daemon.toml"
    path.write_text(runs.path.read_text() + "[serve]\nport = 0\n")
    command = [sys.executable, "-m", "rig", "serve", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("page ")
        process.kill()
        _, err = process.communicate()
    assert f"the guard process {process.pid} has died" in err
    assert holder(runs.port)[0] is None


def test_a_guard_that_is_suspended_ends_the_run_with_the_output_off(runs: KilledRuns) -> None:
    process = runs.start()
    process.send_signal(signal.SIGSTOP)
    try:
        until_s = time.monotonic() + 60.0
        while (runs.witness.on or holder(runs.port)[0] is not None) and time.monotonic() < until_s:
            time.sleep(0.01)
        assert not runs.witness.on
        assert is_suspended(process.pid)  # it had no part in it
    finally:
        process.send_signal(signal.SIGCONT)
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 128 + signal.SIGTERM
    assert f"the guard process {process.pid} is suspended" in err
    assert "output off, confirmed by the controller" in err


def test_a_busy_guard_is_not_suspended() -> None:
    """Running and sleeping processes are not, whatever their name is."""
    assert not is_suspended(os.getpid())
    assert not is_suspended(2**22 + 1)
    sleeper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        assert not is_suspended(sleeper.pid)
        sleeper.send_signal(signal.SIGSTOP)
        os.waitpid(sleeper.pid, os.WUNTRACED)
        assert is_suspended(sleeper.pid)
    finally:
        sleeper.kill()
        sleeper.wait()


CHILD = """
import os, sys, time
import rig.guard.process
from rig.guard.process import guarded
rig.guard.process.keep_trying = lambda held: print("goes on at", held.port, held.dead_man_s, file=sys.stderr)
def work(guard):
    {work}
sys.exit(guarded(work, silence_s=0.3, patience_s=0.2))
"""


def in_a_guarded_process(work: str) -> subprocess.CompletedProcess[str]:
    code = CHILD.format(work=work.replace("\n", "\n    "))
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)


def test_a_process_that_dies_before_it_holds_a_port_does_not_do_so_in_silence() -> None:
    """A system that is out of memory kills one that diagnoses, and the shell sees an ordinary exit of its guard."""
    done = in_a_guarded_process("os.kill(os.getpid(), 9)")
    assert done.returncode == 128 + signal.SIGKILL
    (line,) = done.stderr.splitlines()
    assert line.endswith("died of SIGKILL; it held no controller")


def test_a_port_that_does_not_answer_is_not_confirmed() -> None:
    held = "guard.holds('controller', 'meerstetter', '/dev/ttyNOPE7', {})\n"
    done = in_a_guarded_process(held + "os._exit(0)")
    assert done.returncode == 11
    assert "OUTPUT NOT CONFIRMED OFF" in done.stderr
    assert "/dev/ttyNOPE7" in done.stderr
    assert in_a_guarded_process(held + "guard.let_go()\nreturn 0").returncode == 0


def test_what_the_process_has_given_up_is_not_confirmed_by_anybody_else() -> None:
    """It has told that the controller has to be switched off by hand: the guard says nothing, and somebody goes on."""
    held = "guard.holds('controller', 'meerstetter', '/dev/ttyNOPE7', {}, 4.0)\n"
    done = in_a_guarded_process(held + "guard.busy()\nguard.given_up()\nreturn 11")
    assert done.returncode == 11
    assert done.stderr == "goes on at /dev/ttyNOPE7 4.0\n"
    done = in_a_guarded_process(held + "guard.given_up()\nreturn 11")  # nothing of ours was on
    assert (done.returncode, done.stderr) == (11, "")


def test_nobody_waits_for_a_report_to_learn_that_the_output_may_be_on(tmp_path: Path) -> None:
    """Drawing takes up to a minute: an exit status of 11 that comes so late lets systemd begin anew so late. And what
    is drawn is the run that was going on, not a daemon's job of before."""
    slow = tmp_path / "slow"
    asked = tmp_path / "asked"
    slow.write_text(f'#!/bin/sh\necho "$@" > {asked}.part; mv {asked}.part {asked}; sleep 20\n')
    slow.chmod(0o755)
    held = "guard.holds('controller', 'meerstetter', '/dev/ttyNOPE7', {}, 4.0)\n"
    ends = "guard.given_up()\nreturn 11"
    prelude, over = f"import sys; sys.executable = {str(slow)!r}\n", "guard.records('x')\nguard.records('')\n"
    for records, drawn in (("guard.records('/the/run.part')\n", True), (over, False)):
        begin_s = time.monotonic()
        code = prelude + CHILD.format(work=(held + records + ends).replace("\n", "\n    "))
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
        assert done.returncode == 11
        assert time.monotonic() - begin_s < 15.0
        assert ("/the/run.part/report.html" in done.stderr) is drawn
        if drawn:
            until_s = time.monotonic() + 10.0
            while not asked.exists() and time.monotonic() < until_s:
                time.sleep(0.02)
            assert asked.read_text().split()[-2:] == ["report", "/the/run.part"]
            asked.unlink()
    assert not asked.exists()


def test_a_port_that_cannot_be_opened_anew_confirms_nothing_of_what_was_given_up() -> None:
    """A daemon tries it every few seconds: what it has left on is not somebody else's affair by that."""
    held = "guard.holds('controller', 'meerstetter', '/dev/ttyNOPE7', {}, 4.0)\n"
    done = in_a_guarded_process(f"{held}guard.not_opened()\nreturn 75")  # never ours
    assert (done.returncode, done.stderr) == (75, "")
    again = f"{held}guard.busy()\nguard.given_up()\n{held}guard.not_opened()\n"
    done = in_a_guarded_process(f"{again}{held}guard.not_opened()\ntime.sleep(1.0)\nos._exit(0)")
    assert (done.returncode, done.stderr) == (11, "goes on at /dev/ttyNOPE7 4.0\n")


def test_a_loop_that_hangs_is_ended_also_after_an_off_that_was_not_confirmed() -> None:
    """A daemon's next job is guarded as its first one."""
    done = in_a_guarded_process("guard.busy()\nguard.given_up()\nguard.busy()\ntime.sleep(50.0)\nreturn 0")
    assert done.returncode == 128 + signal.SIGTERM
    assert "no tick for 0.3 s" in done.stderr


UNENDING = """
import os
import rig.guard.process
rig.guard.process.GRACE_S = 0.3
os.kill = lambda pid, number: None
"""


@pytest.mark.parametrize("there", [True, False], ids=["obeys", "its port is gone"])
def test_beside_a_process_that_no_signal_ends_the_output_is_switched_off(tmp_path: Path, there: bool) -> None:
    """A row is written to a disk that hangs: the process waits in the kernel with the current on, and a controller
    without a dead man would heat until somebody comes by."""
    path = write_bench(tmp_path, changed=[('driver = "meerstetter"', 'driver = "te_technology"')])
    instruments = {role: one for role, _, one in emulated_instruments(read_configuration(path), -3.0)}
    controller: Any = instruments["controller"]
    controller.values["power on"] = 1
    controller.receive(b"*000100000000e1\r", -2.0)  # its loops are compiled before it has to answer in time
    controller.transmit(-1.0)
    with PseudoTerminals(instruments) as terminals:
        port = terminals.paths["controller"] if there else "/dev/ttyNOPE7"
        work = f"guard.holds('controller', 'te_technology', {port!r}, {{}})\n    guard.busy()\n    time.sleep(60.0)"
        code = UNENDING + CHILD.format(work=work)
        process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        with process.stderr:
            try:
                said = [process.stderr.readline(), process.stderr.readline()]
            finally:
                process.kill()  # its child dies with it
                process.wait()
        assert controller.values["power on"] == (0 if there else 1)
    assert "ending it" in said[0]
    assert "does not end, not even of SIGKILL" in said[1]
    assert ("output off, confirmed by the controller" in said[1]) is there
    assert ("OUTPUT NOT CONFIRMED OFF" in said[1]) is not there


def test_a_silence_for_the_dead_man_and_an_idle_process_are_no_hanging_loop() -> None:
    waits = "guard.busy()\nfor _ in range(8):\n    time.sleep(0.1)\n    guard.alive()\n"
    assert in_a_guarded_process(f"{waits}guard.idle()\ntime.sleep(1.0)\nreturn 3").returncode == 3


def test_the_guard_is_small() -> None:
    """It imports no arrays and no schema: what the child imports stays in the child."""
    code = "import sys, rig.guard, rig.guard.takeover, rig.command.experiments;"
    code += "rig.guard.takeover.prepare(rig.guard.takeover.Held('controller', 'meerstetter', 'x'));"
    code += "sys.exit(', '.join({'numpy', 'numba', 'scipy', 'pydantic'} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_simulated_ports_need_no_guard(tmp_path: Path) -> None:
    assert not has_real_ports(write_bench(tmp_path))
    assert has_real_ports(write_bench(tmp_path, controller="/dev/ttyUSB0", meter="/dev/ttyUSB1"))
    assert not has_real_ports(tmp_path / "none.toml")


COURSES = """
from rig.safety.switching_off import ExpectedCurves
guard.holds('controller', 'meerstetter', '/dev/ttyNOPE7', {})
guard.busy()
for k in range(2000):
    guard.expects(ExpectedCurves(0.25, (50.0 - 0.01 * k,) * 65, (50.0,) * 65, 2.5, 'the last one'))
    guard.alive()
os.kill(os.getpid(), signal.SIGSTOP)
"""


def test_what_is_told_of_the_temperature_fills_no_pipe() -> None:
    """More than a pipe holds, told faster than a guard reads; all that follows is understood."""
    done = in_a_guarded_process("import signal\n" + COURSES)
    assert done.returncode == 11
    assert "OUTPUT NOT CONFIRMED OFF" in done.stderr
    assert "Traceback" not in done.stderr


READS_AFTER_S = 5.0  # far beyond the second that the last message is waited for


@pytest.fixture
def pipe() -> Iterator[tuple[int, GuardPipe]]:
    reader, writer = os.pipe()
    yield reader, GuardPipe(writer, os.getpid())
    os.close(reader)
    os.close(writer)


def fill(writer: GuardPipe) -> None:
    """Until the pipe takes nothing more: half an hour of a loop at 10 Hz."""
    for _ in range(1 << 16):
        writer.alive()


def seconds(work: Callable[[], None], reader: int) -> float:
    """How long it takes; where it waits for the reader, that reads after some seconds."""
    done = threading.Thread(target=work)
    begin_s = time.monotonic()
    done.start()
    done.join(READS_AFTER_S)
    took_s = time.monotonic() - begin_s
    if done.is_alive():
        os.read(reader, 1 << 20)
        done.join()
    return took_s


def read_all(reader: int) -> list[bytes]:
    os.set_blocking(reader, False)
    found = b""
    try:
        while data := os.read(reader, 1 << 16):
            found += data
    except BlockingIOError:
        pass
    assert found.endswith(b"\n")
    return found.splitlines(keepends=True)


def test_a_guard_that_does_not_read_holds_up_no_loop(pipe: tuple[int, GuardPipe]) -> None:
    reader, writer = pipe
    fill(writer)
    for tell in (writer.busy, writer.idle, writer.let_go):
        assert seconds(tell, reader) < READS_AFTER_S
    assert set(read_all(reader)) == {ALIVE}
    writer.alive()  # what was kept back comes first
    *told, last = read_all(reader)
    assert [json.loads(line)["event"] for line in told] == ["busy", "idle", "let_go"]
    assert last == ALIVE


def test_a_message_in_two_writes_stays_in_one_piece(pipe: tuple[int, GuardPipe]) -> None:
    """One thread begins a run in a folder with a long name, another ticks: the pipe takes the name in parts."""
    reader, writer = pipe
    fill(writer)
    folder = "/".join(["", *["\N{GREEK SMALL LETTER OMEGA}" * 100] * 12])
    telling = threading.Thread(target=writer.records, args=(folder,))
    telling.start()
    found = b""
    until_s = time.monotonic() + 5.0
    while (telling.is_alive() or json.dumps(folder).encode() not in found) and time.monotonic() < until_s:
        found += os.read(reader, 1000)
        writer.alive()
    telling.join(5.0)
    whole = [line for line in found.split(b"\n")[:-1] if line != b"."]
    assert [json.loads(line) for line in whole] == [{"event": "records", "folder": folder}]


def test_a_guard_that_reads_nothing_is_gone(pipe: tuple[int, GuardPipe], monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = pipe
    fill(writer)
    monkeypatch.setattr(guard_line, "DEAF_S", 0.2)
    time.sleep(0.3)
    with pytest.raises(GuardGone, match=r"has read nothing for 0.2 s"):
        writer.alive()
    read_all(reader)
    writer.alive()
