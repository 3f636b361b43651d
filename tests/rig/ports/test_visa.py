"""`visa://RESOURCE` as a port: PyVISA-sim on GPIB, PyVISA-py on a simulated line, and what a bus does."""

from __future__ import annotations

import builtins
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import serial

from rig.core.clock import RealClock
from rig.core.errors import Disconnected, PortHeld, TimedOut
from rig.drivers.registry import METERS, open_meter, searches, tries
from rig.ports import protocol_sim
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Transport
from sim.instruments.source_meters import Keithley2450
from tests.rig.drivers.still_plant import StillPlant

pyvisa = pytest.importorskip("pyvisa", reason="PyVISA is not installed")
pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
from pyvisa.constants import InterfaceType, StatusCode  # noqa: E402
from pyvisa.errors import VisaIOError  # noqa: E402

GPIB = "visa://GPIB0::24::INSTR"


# ---- an independent bus: PyVISA-sim ----------------------------------------------------------------

IDN = "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20"
NONE = '0,"No error"'
DIALOGUE = [
    ("*ESE 8;*ESE?", "8"),
    (":SYST:ERR?;*ESE?;*ESE 9", NONE + ";8"),
    ("*IDN?", IDN),
    ("*ESE 10;*ESE?", "10"),
    (":SYST:ERR?;*ESE?;*ESE 11", NONE + ";10"),
    (":READ?;:FETC?;*ESE?;*ESE 12", "+1.23456789E+03;+1.23456789E+03;11"),
]
BUS = """\
spec: '1.1'
devices:
  meter:
    eom:
      GPIB INSTR: {q: "\\n", r: "\\n"}
    delimiter: '|'
    error: ERROR
    dialogues:
DIALOGUES
resources:
  GPIB0::24::INSTR: {device: meter}
"""


@pytest.fixture
def gpib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A meter that says these lines, on PyVISA-sim's GPIB: its address."""
    pytest.importorskip("pyvisa_sim", reason="PyVISA-sim is not installed")
    said = "".join(f"      - q: '{question}'\n        r: '{answer}'\n" for question, answer in DIALOGUE)
    library = tmp_path / "bus.yaml"
    library.write_text(BUS.replace("DIALOGUES\n", said))
    monkeypatch.setenv("PYVISA_LIBRARY", f"{library}@sim")
    return GPIB


def test_a_driver_on_somebody_elses_bus(gpib: str) -> None:
    meter: Any = open_meter("keithley2000", gpib, RealClock(), first_token=7)
    assert str(meter.identify()) == "Keithley 2000, serial number 1234567, firmware A20"
    assert meter.link.ask(":READ?;:FETC?") == "+1.23456789E+03;+1.23456789E+03"
    meter.close()
    meter.close()


def test_who_is_not_there(gpib: str) -> None:
    with pytest.raises(Disconnected, match=r"visa://GPIB0::25::INSTR: cannot be opened: GPIB0::25::INSTR"):
        open_port("visa://GPIB0::25::INSTR", LineSettings())


# ---- PyVISA-py on a line of ours -------------------------------------------------------------------


def test_a_meter_through_pyvisa_py(plant: StillPlant) -> None:
    protocol_sim.register("visa-test", Keithley2450(plant), RealClock())
    try:
        meter = open_meter("keithley2450", "visa://ASRLsim://visa-test::INSTR", RealClock(), framing="7E2", baud=19200)
        resource: Any = meter.transport.port._resource  # type: ignore[attr-defined]
        assert (resource.baud_rate, resource.data_bits, resource.parity.name) == (19200, 7, "even")
        meter.identify()
        meter.configure(True, 0.1, 1e-3)
        assert meter.read().value == 1e4
        assert meter.off()
        assert plant.test_current_A == 0.0
        meter.close()
    finally:
        protocol_sim.unregister("visa-test")


def test_who_answers_there(plant: StillPlant) -> None:
    protocol_sim.register("visa-ask", Keithley2450(plant), RealClock())
    try:
        found = [one.driver for one in tries("visa://ASRLsim://visa-ask::INSTR", RealClock()) if one.identity]
        assert found == ["keithley2450"]
    finally:
        protocol_sim.unregister("visa-ask")
    on_visa = {driver for _, driver, _ in searches("visa://GPIB0::1::INSTR")}
    assert on_visa == {*METERS, "lakeshore", "srs_ldc500"}


# ---- what a bus does -------------------------------------------------------------------------------


class Bus:
    """A resource that keeps what it is told, and plays what comes back: messages, or errors by name."""

    interface_type = InterfaceType.gpib
    resource_class = "INSTR"
    timeout = 0.0

    def __init__(self) -> None:
        self.said: list[bytes | str] = []
        self.coming: list[bytes | str] = []
        self.timeouts: list[float] = []

    def _raise(self, name: str) -> None:
        raise VisaIOError(StatusCode[name].value)

    def read_raw(self) -> bytes:
        self.timeouts.append(self.timeout)
        found = self.coming.pop(0) if self.coming else "error_timeout"
        if isinstance(found, str):
            self._raise(found)
        assert isinstance(found, bytes)
        return found

    def write_raw(self, data: bytes) -> None:
        self.timeouts.append(self.timeout)
        self.said.append(data)
        if self.coming and isinstance(self.coming[0], str):
            self._raise(str(self.coming.pop(0)))

    def clear(self) -> None:
        self.said.append("device clear")

    def close(self) -> None:
        self.said.append("closed")


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Bus:
    resource = Bus()
    manager = types.SimpleNamespace(open_resource=lambda *_, **__: resource)
    monkeypatch.setattr(pyvisa, "ResourceManager", lambda: manager)
    return resource


@pytest.fixture
def transport(bus: Bus) -> Transport:
    return Transport(open_port(GPIB, LineSettings()), RealClock())  # type: ignore[arg-type]


def test_lines_go_out_one_by_one_and_an_abort_is_a_device_clear(bus: Bus, transport: Transport) -> None:
    transport.send(b"\x18\rSYST:REM\r*ESE 8;*ESE?\r")
    assert bus.said == ["device clear", b"SYST:REM\n", b"*ESE 8;*ESE?\n"]
    transport.send(b":READ?\r\n")
    assert bus.said[3:] == [b":READ?\n"]
    assert bus.timeouts == [1000.0] * 3  # the write time-out of every port


def test_a_message_is_a_line(bus: Bus, transport: Transport) -> None:
    bus.coming = [b"one\n", b"two", b"a;b\r\n"]
    now_s = transport.clock.now_s()
    assert transport.receive_line(b"\n", now_s + 1.0) == b"one"
    assert transport.receive_line(b"\n", now_s + 1.0) == b"two"  # END without a line feed
    assert transport.receive_line(b"\r\n", now_s + 1.0) == b"a;b"
    assert all(0.0 < timeout <= 1000.0 for timeout in bus.timeouts)


def test_silence_is_a_time_out(bus: Bus, transport: Transport) -> None:
    with pytest.raises(TimedOut):
        transport.receive_line(b"\n", transport.clock.now_s() + 0.01)


@pytest.mark.parametrize(
    ("name", "error"),
    [("error_timeout", TimedOut), ("error_connection_lost", Disconnected), ("error_io", Disconnected)],
)
def test_errors_of_the_bus(bus: Bus, transport: Transport, name: str, error: type[Exception]) -> None:
    bus.coming = [name]
    with pytest.raises(error):
        transport.send(b":READ?\n")
    if name != "error_timeout":
        bus.coming = [name]
        with pytest.raises(error):
            transport.receive_line(b"\n", transport.clock.now_s() + 0.1)


def test_a_bus_without_a_device_clear(bus: Bus, transport: Transport, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus, "clear", lambda: bus._raise("error_nonsupported_operation"))
    transport.send(b"\x18\r*ESE?\r")
    assert bus.said == [b"*ESE?\n"]
    monkeypatch.setattr(bus, "clear", lambda: bus._raise("error_io"))
    with pytest.raises(Disconnected):
        transport.send(b"\x18\r*ESE?\r")


def test_closed_and_opened_anew(bus: Bus, transport: Transport) -> None:
    transport.close()
    assert bus.said == ["closed"]
    with pytest.raises(Disconnected):
        transport.send(b"x\n")
    transport.reopen()
    bus.coming = [b"here\n"]
    assert transport.receive_line(b"\n", transport.clock.now_s() + 1.0) == b"here"


def test_a_port_that_is_tried_again_and_again_looks_for_a_library_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def manager() -> types.SimpleNamespace:
        made.append(True)
        return types.SimpleNamespace(open_resource=lambda *_, **__: Bus())

    monkeypatch.setattr(pyvisa, "ResourceManager", manager)
    for _ in range(3):
        open_port(GPIB, LineSettings()).close()
    assert made == [True]


@pytest.mark.parametrize("name", ["error_resource_busy", "error_resource_locked"])
def test_another_process_has_it(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise VisaIOError(StatusCode[name].value)

    monkeypatch.setattr(pyvisa, "ResourceManager", lambda: types.SimpleNamespace(open_resource=refuse))
    with pytest.raises(PortHeld):
        open_port(GPIB, LineSettings())


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    imported: Callable[..., Any] = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith("pyvisa"):
            raise ImportError(name)
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(Disconnected, match=r"pip install 'pyvisa>=") as told:
        open_port(GPIB, LineSettings())
    assert "\n" not in str(told.value)


def test_pyserial_opens_it_by_its_name(bus: Bus) -> None:
    port = serial.serial_for_url(GPIB, timeout=None, write_timeout=None)
    bus.coming = [b"7\n"]
    assert port.read(10) == b"7\n"
    assert port.in_waiting == 0
    port.timeout = 0
    assert port.read(1) == b""
    port.reset_input_buffer()
    port.write(b"X\n")
    port.close()
