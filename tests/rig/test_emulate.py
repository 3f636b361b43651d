"""`emulate`: its lines, and the rig itself as a client on its pseudo-terminals, in real time."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.core.clock import RealClock
from rig.core.errors import PortHeld
from rig.drivers.registry import open_controller, open_meter
from rig.ports.open import LineSettings, open_port
from rig.ports.pseudo_terminal import PseudoTerminals
from tests.peltier import Peltier, begun
from tests.rig.daemon.benches import until
from tests.rig.drivers.far_ends import Wrapped
from tests.rig.small import write_bench

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals need POSIX")


PATIENCE_S = 120.0  # on a busy computer


def emulating(root: Path, *words: object, env: dict[str, str] | None = None) -> subprocess.Popen[str]:
    """`peltier emulate` in a process of its own, with these arguments."""
    return begun("emulate", *words, cwd=root, env=env, stderr=subprocess.PIPE)


@pytest.mark.long
def test_the_first_question_is_answered_though_nothing_was_compiled(tmp_path: Path, root: Path) -> None:
    """As after a fresh set-up: the lines come when it can answer, not before."""
    compiled_nowhere = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cold")}
    process = emulating(root, write_bench(tmp_path), env=compiled_nowhere)
    try:
        assert process.stdout is not None
        ports = [process.stdout.readline().split()[2] for _ in range(2)]
        controller = open_controller("meerstetter", ports[0], RealClock())
        assert controller.read_temperature().is_number
        controller.close()
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)


def test_the_rig_drives_what_emulate_serves(tmp_path: Path, root: Path) -> None:
    process = emulating(root, write_bench(tmp_path), "--speed", 5)
    try:
        assert process.stdout is not None
        words = [process.stdout.readline().split() for _ in range(2)]
        assert [line[:2] for line in words] == [["controller", "meerstetter"], ["meter", "keithley2000"]]
        clock = RealClock()
        controller = open_controller("meerstetter", words[0][2], clock)
        with pytest.raises(PortHeld):
            open_port(words[0][2], LineSettings())
        assert controller.identify().maker == "Meerstetter"
        assert controller.off()
        controller.configure(4.0, (10.0, 95.0), 0.0)  # no dead man: its 5 s would be one of a busy computer's
        controller.arm_current()
        controller.set_current_A(2.0)
        before = controller.read_temperature().value
        meter = open_meter("keithley2000", words[1][2], clock)
        assert meter.identify().model.endswith("2000")
        meter.configure(True, 0.1, 1e-3)
        readings = [meter.read() for _ in range(4)]
        assert readings[-1].is_number
        assert 1e3 < readings[-1].value < 1e6
        until(lambda: controller.read_temperature().value > before + 0.1, "the heat")
        assert controller.off()
        controller.close()
        meter.close()
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert out == ""
    assert process.returncode == 128 + signal.SIGINT, err


@contextlib.contextmanager
def open_in_another(port: str, lock: bool | None) -> Iterator[subprocess.Popen[str]]:
    """Another process that has a port open. lock: None, as most programs open one."""
    code = f"import serial, sys; p = serial.Serial({port!r}, exclusive={lock}); print('held', flush=True); "
    code += "sys.stdin.read()"
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    yield other
    other.communicate()


class Heard(Wrapped):
    """An instrument, and what it was told."""

    data = b""

    def receive(self, data: bytes, time_s: float) -> None:
        self.data += data
        super().receive(data, time_s)


@pytest.mark.parametrize(
    ("verb", "role", "lock"),
    [("run", "controller", True), ("check", "controller", True), ("run", "controller", None), ("run", "meter", None)],
)
def test_a_port_of_another_process(tmp_path: Path, peltier: Peltier, verb: str, role: str, lock: bool | None) -> None:
    """With a lock, or without one, as most programs open it: in one line, before anything is sent."""
    path = write_bench(tmp_path)
    instruments = {role: Heard(i) for role, _, i in emulated_instruments(read_configuration(path), 0.0)}
    with PseudoTerminals(instruments) as terminals:
        path = write_bench(tmp_path, time="real", **terminals.paths)
        with open_in_another(terminals.paths[role], lock) as other:
            status, _, err = peltier(verb, path, *(("--out", tmp_path / "run") if verb == "run" else ()))
    assert status == 75
    (line,) = err.splitlines()
    assert f"{terminals.paths[role]} is held by process {other.pid} (" in line
    assert [one.data for one in instruments.values()] == [b"", b""]
    assert not (tmp_path / "run").exists()


def test_check_tells_who_else_has_a_port_open(tmp_path: Path, peltier: Peltier) -> None:
    """A program that takes no lock is kept out by none, and can switch the output on."""
    path = write_bench(tmp_path)
    instruments = {role: i for role, _, i in emulated_instruments(read_configuration(path), 0.0)}
    with PseudoTerminals(instruments) as terminals:
        port = terminals.paths["controller"]
        path = write_bench(tmp_path, time="real", controller=port, meter=terminals.paths["meter"])
        with open_in_another(port, None) as other:
            status, out, err = peltier("check", path)
        assert status == 1, err
        (line,) = [line for line in out.splitlines() if "open as well" in line]
        assert line.startswith(f"NOT AS CONFIGURED: {port}: process {other.pid} (")
        status, out, err = peltier("check", path)
    assert status == 0, err
    assert "open as well" not in out


def test_instruments_with_parity_are_emulated_too(tmp_path: Path, peltier: Peltier) -> None:
    """Linux sets neither parity nor seven bits at a pseudo-terminal: 7O1 and 7E2 are for real lines."""
    path = write_bench(tmp_path, time="real")
    text = path.read_text().replace('"meerstetter"', '"lakeshore"').replace('"keithley2000"', '"hp34401a"')
    path.write_text(text.replace("current_A = 4.0", "current_A = 1.0"))
    emulated = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
    with PseudoTerminals(emulated) as terminals:
        for role in ("controller", "meter"):
            path.write_text(path.read_text().replace('"sim://"', f'"{terminals.paths[role]}"', 1))
        status, out, err = peltier("check", path)
    assert (status, err) == (0, "")
    assert "controller: Lake Shore 335" in out
    assert "34401A" in out


def test_an_output_that_was_left_on_is_told(tmp_path: Path, root: Path) -> None:
    """A program of one's own that ends without switching off: while it is silent, and at the end."""
    process = emulating(root, write_bench(tmp_path))
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        port = process.stdout.readline().split()[2]
        controller = open_controller("meerstetter", port, RealClock())
        controller.configure(4.0, (10.0, 95.0), 0.0)
        controller.arm_current()
        controller.set_current_A(1.0)
        controller.close()
        told = process.stderr.readline()
        assert "its output is on, 1 A, and nobody has spoken to it for" in told
        again = open_controller("meerstetter", port, RealClock())
        again.configure(4.0, (10.0, 95.0), 0.5)
        again.arm_current()
        again.set_current_A(1.0)
        again.close()
        assert "it has switched its output off by itself" in process.stderr.readline()
    finally:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert "controller: at the end its output is off" in err
