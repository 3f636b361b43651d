"""Off against a controller that does not obey: a verdict in time, its dead man left in peace; who goes on trying."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.core.clock import VirtualClock
from rig.core.errors import PortHeld
from rig.drivers.registry import open_controller
from rig.ports import protocol_sim
from rig.ports.open import LineSettings, holder, is_still_trying, open_port
from rig.ports.pseudo_terminal import PseudoTerminals
from rig.safety.switching_off import BY_ITS_DEAD_MAN, look_after_silence, off_confirmed, switch_off
from sim.instruments.instrument import emulated
from tests.rig.drivers.disobedient import Disobedient
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.small import write_bench

DEAD_MAN_S = 3.0
OFF_S = 0.75  # as long as `off` may take against a device that does not answer, about
Bench = Callable[[str, str], tuple[Any, Disobedient, StillPlant, VirtualClock]]


@pytest.fixture
def armed() -> Iterator[Bench]:
    """An armed controller of a driver with a current on, which does not obey any more."""

    def make(driver: str, fault: str) -> tuple[Any, Disobedient, StillPlant, VirtualClock]:
        clock, plant = VirtualClock(), StillPlant()
        wrapped = Disobedient(emulated(driver, plant), fault)
        controller = open_controller(driver, protocol_sim.register("disobedient", wrapped, clock), clock)
        controller.configure(4.0, (10.0, 95.0), DEAD_MAN_S)
        if controller.commands_current:
            controller.arm_current()
            controller.set_current_A(1.5)
        else:
            controller.arm_setpoint()
            controller.set_setpoint_degC(60.0)
            clock.sleep_until_s(clock.now_s() + 0.3)
            wrapped.transmit(clock.now_s())
        assert plant.current_A > 1.0
        wrapped.begin()
        return controller, wrapped, plant, clock

    yield make
    protocol_sim.unregister("disobedient")


def gone_after_s(plant: StillPlant, begin_s: float) -> float:
    """Until the current was gone for good."""
    assert plant.current_A == 0.0
    return max(time_s for time_s, current_A in plant.currents if current_A == 0.0) - begin_s


@pytest.mark.parametrize("fault", ["deaf", "deaf to all", "silent", "replies lost"])
def test_the_current_is_gone_within_the_dead_mans_time_and_a_second(armed: Bench, fault: str) -> None:
    controller, wrapped, plant, clock = armed("meerstetter", fault)
    begin_s = clock.now_s()
    verdict = switch_off(controller)
    wrapped.transmit(clock.now_s())
    assert gone_after_s(plant, begin_s) <= DEAD_MAN_S + 1.0
    assert verdict.confirmed == (fault in ("deaf", "deaf to all"))  # what answers can be looked at
    assert clock.now_s() - begin_s < DEAD_MAN_S + 3.0


def test_a_confirmation_by_its_dead_man_is_told_as_that(armed: Bench) -> None:
    controller, _, _, _ = armed("meerstetter", "deaf to all")
    assert switch_off(controller).text == BY_ITS_DEAD_MAN


def test_the_emergency_stop_counts_where_it_is_obeyed(armed: Bench) -> None:
    controller, _, plant, clock = armed("meerstetter", "deaf")
    begin_s = clock.now_s()
    assert controller.off()
    assert clock.now_s() - begin_s < OFF_S
    assert plant.current_A == 0.0
    assert controller.status().code == 11
    assert "emergency stop" in controller.status().meaning


def test_an_off_that_fails_waits_for_the_dead_man(armed: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    controller, _, plant, clock = armed("meerstetter", "deaf")

    def fails() -> bool:
        raise RuntimeError("out of order")

    monkeypatch.setattr(controller, "off", fails)
    begin_s = clock.now_s()
    assert switch_off(controller).text == BY_ITS_DEAD_MAN
    assert gone_after_s(plant, begin_s) < DEAD_MAN_S + 1.0
    monkeypatch.setattr(type(controller), "has_dead_man", False)
    verdict = switch_off(controller)
    assert not verdict.confirmed
    assert "out of order" in verdict.text


def test_no_dead_man_no_silence(armed: Bench) -> None:
    """A TE Technology that is deaf: at once not confirmed; it has nobody who would switch it off."""
    controller, _, plant, clock = armed("te_technology", "deaf")
    begin_s = clock.now_s()
    verdict = switch_off(controller)
    assert not verdict.confirmed
    assert clock.now_s() - begin_s < 1.5
    assert plant.current_A > 1.0


@pytest.mark.parametrize("driver", ["meerstetter", "te_technology", "srs_ldc500"])
@pytest.mark.parametrize("fault", ["silent", "replies lost"])
def test_off_is_over_in_time(armed: Bench, driver: str, fault: str) -> None:
    controller, _, _, clock = armed(driver, fault)
    begin_s = clock.now_s()
    assert controller.off() is False
    assert clock.now_s() - begin_s < OFF_S


def test_a_current_that_flows_is_not_off(armed: Bench) -> None:
    """The status says "ready", 2010 reads 0: only the current gives it away."""
    controller, wrapped, plant, _ = armed("meerstetter", "lying")
    wrapped.instrument._measured[1020] = lambda: 1.5
    assert controller.off() is False
    assert plant.current_A == 1.5


def test_what_is_sent_in_the_silence(armed: Bench) -> None:
    """Nothing: a frame would feed the dead man. Then a look, which commands nothing."""
    controller, wrapped, _, clock = armed("meerstetter", "deaf to all")
    sent: list[tuple[float, bytes]] = []
    receive = wrapped.instrument.receive
    wrapped.instrument.receive = lambda data, time_s: (sent.append((time_s, data)), receive(data, time_s))
    begin_s = clock.now_s()
    ticks: list[float] = []
    switch_off(controller, alive=lambda: ticks.append(clock.now_s()))
    talk = [time_s - begin_s for time_s, data in sent if b"VS" in data or b"ES" in data]
    looks = [time_s - begin_s for time_s, data in sent if time_s - begin_s > OFF_S]
    assert max(talk) < OFF_S
    assert min(looks) > max(talk) + DEAD_MAN_S
    assert all(b"?VR" in data for time_s, data in sent if time_s - begin_s > OFF_S)
    assert max(b - a for a, b in pairwise(ticks)) < 1.0  # the guard hears that somebody is there


def test_the_plain_off_is_the_first_thing_said(armed: Bench) -> None:
    controller, wrapped, _, clock = armed("meerstetter", "deaf to all")
    sent: list[tuple[float, bytes]] = []
    wrapped.instrument.receive = lambda data, time_s: sent.append((time_s, data))
    begin_s = clock.now_s()
    controller.off()
    assert sent[0][0] == begin_s
    assert b"VS07DA0100000000" in sent[0][1]


def test_a_controller_that_still_runs_after_the_silence_is_not_off(armed: Bench) -> None:
    controller, wrapped, _, clock = armed("meerstetter", "deaf to all")
    wrapped.instrument._values[2060] = 0.0  # somebody has switched its dead man off
    wrapped.instrument._watch()
    verdict = look_after_silence(controller, DEAD_MAN_S, clock.now_s())
    assert not verdict.confirmed
    assert "running" in verdict.text


def test_what_confirmed_rests_on_is_said() -> None:
    from rig.drivers.registry import controller_class

    assert "shows no current" in off_confirmed(controller_class("te_technology"))
    assert "the current that it measures" in off_confirmed(controller_class("meerstetter"))


def test_a_status_that_comes_a_step_later_is_waited_for(armed: Bench) -> None:
    controller, _, plant, _ = armed("meerstetter", "late status")
    assert controller.off()
    assert not controller.status().is_error  # no emergency stop was needed
    controller.arm_current()
    controller.set_current_A(1.0)
    assert plant.current_A == 1.0


def test_an_adapter_that_comes_back_in_the_silence(armed: Bench) -> None:
    """Unplugged, the dead man acts, and the look finds the port again."""
    controller, wrapped, plant, clock = armed("meerstetter", "deaf to all")
    protocol_sim.unregister("disobedient")
    verdict = switch_off(
        controller,
        alive=lambda: protocol_sim.look_up("disobedient") or protocol_sim.register("disobedient", wrapped, clock),
    )
    assert verdict.confirmed
    assert plant.current_A == 0.0


pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it is known by its name in /proc")


@pytest.fixture
def deaf(tmp_path: Path) -> Iterator[tuple[Path, Disobedient, str]]:
    """Its configuration, the controller with its power on, and its port."""
    path = write_bench(tmp_path)
    text = path.read_text().replace('driver = "meerstetter"', 'driver = "te_technology"')
    path.write_text(text)
    instruments = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
    controller = Disobedient(instruments["controller"], "deaf")
    controller.instrument.values["power on"] = 1
    controller.begin()
    with PseudoTerminals({**instruments, "controller": controller}) as terminals:
        port = terminals.paths["controller"]
        text = text.replace('port = "sim://"', f'port = "{port}"', 1).replace("sim://", terminals.paths["meter"])
        path.write_text(text.replace('time = "virtual"', 'time = "real"'))
        yield path, controller, port
        pid, _ = holder(port)
        if pid is not None and is_still_trying(pid):
            os.kill(pid, signal.SIGKILL)


def peltier(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "rig", *map(str, words)], capture_output=True, text=True, timeout=60.0)


def test_it_goes_on_and_tells_who_asks(deaf: tuple[Path, Disobedient, str]) -> None:
    path, controller, port = deaf
    done = peltier("off", path)
    assert done.returncode == 11
    assert "OUTPUT NOT CONFIRMED OFF" in done.stderr
    assert "by hand" in done.stderr
    until_s = time.monotonic() + 30.0
    while holder(port)[0] is None and time.monotonic() < until_s:
        time.sleep(0.01)
    with pytest.raises(PortHeld, match="still trying to switch the output off") as held:
        open_port(port, LineSettings())
    assert held.value.exit_status == 75
    pid, _ = holder(port)
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)  # so that it does not get there first
    controller.heal()
    third = peltier("off", path)  # is not locked out; but a hand was asked for, and nobody says "confirmed" any more
    assert controller.values["power on"] == 0
    assert third.returncode == 11
    assert "says now that its output is off" in third.stderr
    assert peltier("off", path).returncode == 0
