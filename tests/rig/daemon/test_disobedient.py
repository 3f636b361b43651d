"""A controller that does not obey "off" under the daemon: nobody speaks until its dead man has acted."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import pytest

from rig.bench.assembly import emulated_instruments, open_bench, simulated_world
from rig.config.configuration import read_configuration
from rig.core.errors import Disconnected
from rig.core.outcome import NotConfirmedOff, Stopped
from rig.daemon import supervisor
from rig.daemon.command_queue import HISTORY, CommandQueue
from rig.daemon.latch import OFF_CONTRADICTED
from rig.daemon.systemd import Notifier
from rig.guard.stale_run import write_end
from rig.ports.open import holder
from rig.ports.pseudo_terminal import PseudoTerminals
from rig.safety.switching_off import BY_ITS_DEAD_MAN
from sim.world.plant import SimulatedPlant
from tests.peltier import begun
from tests.rig.daemon.benches import LONGEST_S, SERVE, RunningBench, environment, put_on, running, until, write_current
from tests.rig.drivers.disobedient import Disobedient
from tests.rig.history.test_history import locked

DEAD_MAN_S, LATE_S = 2.0, 1.5  # LATE_S: that a busy computer may be


@contextlib.contextmanager
def bench_of(tmp_path: Path, fault: str) -> Iterator[tuple[RunningBench, Disobedient, Path]]:
    """A bench on a real clock and pseudo-terminals, its controller, and the configuration of a job."""
    path = write_current(tmp_path, '["start 1 A", "hold 60 s"]', more=SERVE)
    text = path.read_text()
    plant = SimulatedPlant(simulated_world(read_configuration(path)), 0.0)
    plant.advance_to(1.0)  # its loops are compiled before a controller in this process has to answer in time,
    plant.read_resistance_ohm(1e-4)  # the film's, too
    instruments: dict[str, Any] = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
    controller = Disobedient(instruments["controller"], fault)
    with PseudoTerminals({**instruments, "controller": controller}) as terminals:
        port = f'port = "{terminals.paths["controller"]}"\ndead_man_s = {DEAD_MAN_S}'
        text = text.replace('port = "sim://"', port, 1).replace("sim://", terminals.paths["meter"])
        path.write_text(text.replace('time = "virtual"', 'time = "real"'))
        with running(path) as bench:
            yield bench, controller, path


def heated(bench: RunningBench, controller: Disobedient, path: Path) -> None:
    """A job has its current on; where it ends before, its reason is told."""
    job = bench.commands.submit(read_configuration(path))
    until(lambda: controller.instrument.output_A == 1.0 or job.ended_s is not None, "the current")
    assert job.ended_s is None, job.reason


@pytest.mark.parametrize("fault", ["deaf to all", "silent"])
def test_stop_leaves_the_dead_man_in_peace(tmp_path: Path, fault: str) -> None:
    with bench_of(tmp_path, fault) as (bench, controller, path):
        heated(bench, controller, path)
        controller.begin()
        begin_s = time.monotonic()
        assert not bench.commands.stop("somebody").confirmed
        until(lambda: controller.instrument.output_A == 0.0, "off by the dead man")
        assert time.monotonic() - begin_s < DEAD_MAN_S + 1.0 + LATE_S
        controller.heal()
        until(lambda: bench.commands.confirmed, "the confirmation")


def test_an_output_that_somebody_else_switched_on_and_that_stays_on(tmp_path: Path) -> None:
    """While nothing runs the daemon reads ten times a second, which would feed the dead man for ever."""
    with bench_of(tmp_path, "deaf to all") as (bench, controller, _):
        controller.begin()
        for number, value in ((2000, 1), (50001, 0.5), (50000, 1), (2010, 1)):
            controller.instrument._values[number] = value
        controller.instrument._move_output()
        assert controller.instrument.output_A == 0.5
        until(lambda: not bench.commands.confirmed, "that it does not obey")
        until(lambda: controller.instrument.output_A == 0.0, "off by the dead man")
        until(lambda: bench.commands.confirmed, "the confirmation")
        assert BY_ITS_DEAD_MAN in bench.commands.notes


def test_a_controller_that_is_back_with_its_output_off_has_no_armed_loop(tmp_path: Path) -> None:
    """The guard would end the daemon, half a minute after the controller that it had armed and lost has come back."""
    guard = Mock()
    with open_bench(read_configuration(write_current(tmp_path)), guard):
        assert [name for name, *_ in guard.method_calls] == ["holds", "idle", "holds"]


def test_an_end_before_it_is_ready_is_told_to_systemd(tmp_path: Path) -> None:
    """The dead man of a controller that is silent from the first "off" on is waited for, whoever ends the daemon."""
    path = write_current(tmp_path, '["start 1 A", "hold 60 s"]')
    emulated: dict[str, Any] = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
    emulated["controller"] = Disobedient(emulated["controller"], "silent")
    emulated["controller"].begin()
    with PseudoTerminals(emulated) as terminals, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notified:
        notified.bind(str(tmp_path / "notify"))
        notified.settimeout(LONGEST_S)
        put_on(path, terminals.paths)
        with begun("serve", path, env=environment(tmp_path), stderr=subprocess.PIPE) as daemon:
            until(lambda: holder(terminals.paths["controller"])[0], "the port")
            daemon.terminate()
            assert notified.recv(4096) == b"EXTEND_TIMEOUT_USEC=30000000"  # its dead man's 5 s
            _, err = daemon.communicate()
    assert daemon.returncode == NotConfirmedOff.exit_status
    assert "OUTPUT NOT CONFIRMED OFF" in err


@pytest.mark.parametrize("left", ["not confirmed", "gone since", "contradicted"])
def test_an_end_with_an_unknown_output_names_it(left: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where its port has gone since: nobody has confirmed the off that was not confirmed before."""
    commands = cast(CommandQueue, Mock(contradicted=left == "contradicted", wake=threading.Event()))
    table = SimpleNamespace(port="/dev/one", dead_man_s=5.0)
    file = SimpleNamespace(content=SimpleNamespace(bench=SimpleNamespace(controller=table)))
    one = supervisor.Supervisor(cast(Any, file), commands, Notifier())
    ways = {
        "not confirmed": [NotConfirmedOff("/dev/one: it did not confirm")],
        "gone since": [NotConfirmedOff("/dev/one: it did not confirm"), Disconnected("no such file")],
        "contradicted": [Stopped(signal.SIGTERM)],
    }[left]

    def open_bench(*_: object) -> Any:
        commands.wake.set()  # nobody waits for the next attempt
        error = ways.pop(0)
        if not ways:
            one.end()
        raise error

    monkeypatch.setattr(supervisor, "open_bench", open_bench)
    with pytest.raises(NotConfirmedOff, match=r"^/dev/one: ") as ended:
        one.keep()
    assert isinstance(ended.value.__cause__, Stopped)
    tried_again = cast(Mock, commands).enter_in_log.call_count
    assert tried_again == (left == "gone since")  # no log promises another attempt to a daemon that ends


@pytest.mark.parametrize(("confirmed", "lock"), [(True, False), (False, False), (False, True)])
def test_what_the_guard_found_out_holds_after_a_restart(tmp_path: Path, confirmed: bool, lock: bool) -> None:
    """The daemon's process died in a job; the controller says "off" to the next one, as it did to the guard."""
    path = write_current(tmp_path, '["start 1 A", "hold 60 s"]', more=SERVE)
    folder = tmp_path / "job.part"
    (folder / "calibration.part").mkdir(parents=True)
    run = folder / "calibration.part" / "run.json"
    run.write_text(json.dumps({"format": "peltier-run/1", "start": {}}))
    write_end(str(run.parent), "the thermometer shows 40 degC", confirmed)
    assert json.loads(run.read_text())["stop"]["output_off_confirmed"] is confirmed
    with running(path) as bench:
        job = bench.commands.submit(read_configuration(path))
        until(lambda: bench.commands.queue.running is not None, "the job")
        assert bench.commands.stop("a test").confirmed
        until(lambda: bench.commands.queue.running is None, "its end")
        assert bench.commands.reset("a test")
        died = {**job.table(), "state": "running", "folder": str(folder)}
        bench.commands.writer.do(lambda store: store.save_job(died))
        assert bench.commands.writer.settle()
    history = locked(bench.commands.folder / HISTORY) if lock else contextlib.nullcontext(lambda: None)
    with history as let_go, running(path, ends=Stopped if confirmed else NotConfirmedOff) as bench:
        until(lambda: bench.commands.ticks.done > 3, "some readings")
        if lock:  # nobody can read yet what became of the job: no other one begins
            assert "cannot be read yet" in bench.state()["no_job_because"][0]
            let_go()
            bench.until_state("tripped")
        state = bench.state()
        if confirmed:
            assert (state["state"], state["output_confirmed"]) == ("idle", True)
            return
        assert (state["state"], state["output_confirmed"]) == ("tripped", False)
        assert state["trip"]["cause"] == OFF_CONTRADICTED
        assert "40 degC" in state["trip"]["text"]
    with running(path) as bench:
        assert not bench.state()["output_confirmed"]
        assert bench.commands.reset("looked at it")
        until(lambda: bench.state()["output_confirmed"], "the confirmation")
