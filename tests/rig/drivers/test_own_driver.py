"""A user-defined driver, docs/bath.py of docs/own_driver.md: by name, with faults told, on a foreign simulator."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Disconnected, InstrumentError, Refused
from rig.core.reading import Quality
from rig.drivers.registry import open_controller
from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.instrument import Instrument
from sim.instruments.meerstetter import MeerstetterTec
from tests.peltier import Peltier
from tests.rig.drivers.far_ends import Answering
from tests.rig.drivers.still_plant import StillPlant

PAGE = Path(__file__).resolve().parents[3] / "docs" / "own_driver.md"
CONFIGURATION = """
[bench.controller]
driver = "bath.py:JulaboBath"
port = "{port}"
[limits]
temperature_degC = [0, 100]
current_A = 1.0
[experiment]
kind = "hold"
"""


@pytest.fixture
def bath_file(tmp_path: Path) -> Path:
    """The driver of the page, beside a configuration."""
    return shutil.copy(PAGE.with_name("bath.py"), tmp_path / "bath.py")


class Bath(Answering):
    """A bath at the far end of the line, at once; `spoil` changes its answers."""

    def __init__(self) -> None:
        super().__init__()
        self.temperature_degC, self.setpoint_degC, self.on = 24.0, 24.0, 0
        self.spoil: Callable[[bytes], bytes] = lambda answer: answer

    def receive(self, data: bytes, time_s: float) -> None:
        for line in data.decode("latin-1").split("\r")[:-1]:
            word, _, value = line.partition(" ")
            if word == "OUT_SP_00":
                self.setpoint_degC = float(value)
            elif word == "OUT_MODE_05":
                self.on = int(value)
            answers = {
                "IN_PV_00": self.temperature_degC,
                "IN_SP_00": self.setpoint_degC,
                "IN_SP_01": 100.0,
                "IN_SP_02": 0.0,
                "IN_MODE_05": self.on,
                "STATUS": "00 ALL WELL",
                "VERSION": "JULABO FP50",
            }
            if word in answers:
                self.answer(time_s + 0.01, self.spoil(str(answers[word]).encode() + b"\r\n"))


def test_the_driver_of_the_page(bath_file: Path, attach: Callable[[Instrument], str], clock: VirtualClock) -> None:
    bath = Bath()
    controller = open_controller(f"{bath_file}:JulaboBath", attach(bath), clock, drain_s=0.2)
    assert controller.identify().maker == "Julabo"
    controller.configure(1.0, (10.0, 90.0), 0.0)
    controller.arm_setpoint()
    controller.set_setpoint_degC(42.5)
    assert (bath.setpoint_degC, bath.on) == (42.5, 1)
    assert controller.read_temperature().value == 24.0
    assert controller.status().output_is_on
    assert controller.own_limits().high_degC == 100.0
    assert controller.read_current().quality is Quality.INVALID
    for refused in (controller.arm_current, lambda: controller.set_ramp_K_per_s(1.0)):
        with pytest.raises(Refused):
            refused()
    with pytest.raises(ValueError, match="outside"):
        controller.set_setpoint_degC(95.0)
    assert controller.off()
    assert bath.on == 0
    controller.close()


def test_out_of_step_is_no_answer(bath_file: Path, attach: Callable[[Instrument], str], clock: VirtualClock) -> None:
    bath = Bath()
    controller = open_controller(f"{bath_file}:JulaboBath", attach(bath), clock)
    controller.identify()
    answers = iter([b"", b"24.0\r\nJULABO FP50\r\n", b"21.0\r\n"])
    bath.spoil = lambda answer: next(answers, answer)
    refused, values = 0, []
    for _ in range(6):
        try:
            values.append(controller.read_temperature().value)
        except InstrumentError:
            refused += 1
    assert refused > 0
    assert set(values) == {24.0}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "no class JulaboBath"),
        ("class JulaboBath: pass", "lacks LINE, arm_current"),
        ("import nothing_of_the_kind", "cannot be imported: ModuleNotFoundError"),
    ],
)
def test_a_file_that_is_no_driver(tmp_path: Path, text: str, expected: str) -> None:
    (tmp_path / "bath.py").write_text(text)
    with pytest.raises(ValueError, match=expected):
        open_controller(f"{tmp_path / 'bath.py'}:JulaboBath", "sim://nobody", VirtualClock())


def test_a_file_that_is_not_there(tmp_path: Path, peltier: Peltier) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(CONFIGURATION.format(port="/dev/null"))
    assert "there is no such file" in peltier.fails("check", path)


OWN_TEC = """
from rig.drivers.meerstetter import MeerstetterController
class Tec(MeerstetterController):
    pass
"""


@pytest.fixture
def own_tec(tmp_path: Path) -> Path:
    """A configuration with such a driver beside it."""
    (tmp_path / "tec.py").write_text(OWN_TEC)
    path = tmp_path / "rig.toml"
    path.write_text(CONFIGURATION.replace("bath.py:JulaboBath", "tec.py:Tec"))
    return path


def test_off_takes_the_file_from_beside_the_configuration(own_tec: Path, plant: StillPlant, peltier: Peltier) -> None:
    with PseudoTerminals({"it": MeerstetterTec(plant)}) as terminals:
        own_tec.write_text(own_tec.read_text().replace("{port}", terminals.paths["it"]))
        status, out, err = peltier("off", own_tec)
    assert status == 0, err
    assert "output off, confirmed by the controller" in out


@pytest.mark.parametrize(
    ("text", "expected"),
    [(None, "there is no file"), ("", "there is no class Tec"), (OWN_TEC + "    LINE = 0\n", "NOT CONFIRMED OFF")],
)
def test_off_by_a_driver_that_cannot_be_had(own_tec: Path, peltier: Peltier, text: str | None, expected: str) -> None:
    """Somebody has to know that the output may still be on."""
    file = own_tec.with_name("tec.py")
    file.unlink() if text is None else file.write_text(text)
    own_tec.write_text(own_tec.read_text().replace("{port}", "/dev/null"))
    status, _, err = peltier("off", own_tec)
    assert status == (11 if "NOT" in expected else 2)
    assert expected in err
    assert "witch the controller off by hand" in err
    assert status == 11 or "nothing was sent, and the output may be on" in err


# ---- lewis (GPL-3), in a process of its own ---------------------------------------------------------


@pytest.fixture
def lewis_bath() -> Iterator[str]:
    """Lewis's own Julabo bath on TCP: its address."""
    if find_spec("lewis") is None:
        pytest.skip("lewis is not installed")
    program = shutil.which("lewis", path=str(Path(sys.executable).parent))
    assert program is not None
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen(
        [program, "-p", f"julabo-version-1: {{bind_address: 127.0.0.1, port: {port}}}", "julabo"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        for _ in range(200):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert process.poll() is None, "lewis has ended"
            time.sleep(0.05)
        yield f"socket://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(10)


def test_check_on_a_simulator_that_others_wrote(bath_file: Path, lewis_bath: str, peltier: Peltier) -> None:
    path = bath_file.parent / "rig.toml"
    path.write_text(CONFIGURATION.format(port=lewis_bath))
    status, out, err = peltier("check", path)
    assert status == 0, (out, err)
    assert "JULABO FP50_MH Simulator" in out
    assert "temperature: 24.000 degC" in out
    assert "0 to 100 degC" in out


def test_a_bath_that_others_wrote_is_regulated(bath_file: Path, lewis_bath: str) -> None:
    from rig.core.clock import RealClock

    controller: Any = open_controller(f"{bath_file}:JulaboBath", lewis_bath, RealClock(), drain_s=0.1)
    controller.identify()
    controller.configure(1.0, (0.0, 100.0), 0.0)
    controller.arm_setpoint()
    controller.set_setpoint_degC(30.0)
    before = controller.read_temperature().value
    time.sleep(1.0)
    assert controller.read_temperature().value > before
    assert controller.off()
    controller.close()
    with pytest.raises(Disconnected):
        controller.read_temperature()
