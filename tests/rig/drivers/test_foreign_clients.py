"""Independent software drives our emulators on a pseudo-terminal, and so do our own drivers; ours drives sciglob's.

PyMeasure, QCoDeS, mecompyapi, sciglob, and the packages of Lake Shore and of TCLab.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
import types
import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from rig.core.clock import RealClock, VirtualClock
from rig.core.errors import Refused, TimedOut
from rig.drivers import registry
from rig.drivers.meerstetter import MecomLink
from rig.drivers.registry import open_controller, open_meter
from rig.ports.open import LineSettings, open_port
from rig.ports.pseudo_terminal import PseudoTerminals
from rig.ports.transport import Transport
from sim.instruments.instrument import Instrument, emulated
from sim.instruments.lakeshore import LakeShore
from sim.instruments.tclab import TcLab
from tests.rig.drivers.far_ends import Answering
from tests.rig.drivers.still_plant import StillPlant

pytestmark = pytest.mark.filterwarnings("ignore")
Serve = Callable[[Instrument], str]


@pytest.fixture
def serve(plant: StillPlant) -> Iterator[Serve]:
    """Put an instrument on a pseudo-terminal: its path."""
    served: list[PseudoTerminals] = []

    def put(instrument: Instrument) -> str:
        served.append(PseudoTerminals({"it": instrument}))
        served[-1].start()
        return served[-1].paths["it"]

    yield put
    for terminals in served:
        terminals.stop()


# ---- PyMeasure ------------------------------------------------------------------------------------


def kept(client: Any, **values: object) -> None:
    """What is set reads back."""
    for name, value in values.items():
        setattr(client, name, value)
        assert getattr(client, name) == value, name


def exercise_keithley2000(meter: Any, plant: StillPlant) -> None:
    assert "MODEL 2000" in meter.id
    meter.reset()
    for wires, prefix, mode in ((2, "resistance", "resistance"), (4, "resistance_4W", "resistance 4W")):
        plant.resistance_ohm = 123.456
        meter.measure_resistance(1e3, wires)
        assert (meter.mode, getattr(meter, prefix + "_range"), meter.resistance) == (mode, 1e3, 123.456)
        values = {"nplc": 0.1, "digits": 5, "reference": 2.5, "range": 1e5}
        kept(meter, **{f"{prefix}_{name}": value for name, value in values.items()})
        assert plant.test_current_A == 1e-5
        meter.auto_range()
        assert (meter.resistance, getattr(meter, prefix + "_range")) == (123.456, 1e3)
        plant.resistance_ohm = math.inf
        assert meter.resistance == 9.9e37
        for name in ("enable_filter", "disable_filter", "enable_reference", "acquire_reference", "disable_reference"):
            getattr(meter, name)()
    plant.resistance_ohm = 77.0
    kept(meter, trigger_count=3)
    assert meter.resistance == [77.0, 77.0, 77.0]
    kept(meter, trigger_delay=0.25, beep_state="enabled")
    meter.beep(440, 0.1)
    for name in ("local", "remote", "remote_lock"):
        getattr(meter, name)()
    assert meter.check_errors() == []


def exercise_hp34401a(meter: Any, plant: StillPlant) -> None:
    meter.remote_control_enabled = True
    assert meter.id.startswith("HEWLETT-PACKARD,34401A")
    plant.resistance_ohm = 123.456
    for function in ("R2W", "R4W"):
        kept(meter, function_=function, range_=1000, autorange=False, nplc=0.2)
        assert plant.test_current_A == 1e-3
        assert meter.reading == 123.456
    meter.init_trigger()
    assert (meter.stored_reading, meter.stored_readings_count) == (123.456, 1)
    meter.sample_count = 3
    assert list(meter.reading) == [123.456] * 3
    plant.resistance_ohm = math.inf
    assert list(meter.reading) == [9.9e37] * 3
    plant.resistance_ohm = 77.0
    assert meter.resistance_4w == 77.0
    kept(meter, autozero_enabled=False, autorange=True)
    assert (meter.terminals_used, meter.scpi_version) == ("FRONT", 1991.0)
    meter.beep()
    assert meter.ask("SYST:ERR?").strip() == '+0,"No error"'
    meter.remote_control_enabled = False


def exercise_keithley2400(meter: Any, plant: StillPlant) -> None:
    assert "MODEL 2400" in meter.id
    meter.reset()
    plant.resistance_ohm = 1234.5
    meter.measure_resistance(nplc=0.1, resistance=2e3, auto_range=False)
    assert (meter.resistance_range, meter.resistance_mode_auto_enabled) == (2e3, False)
    meter.resistance_mode_auto_enabled = True
    meter.enable_source()
    assert (meter.source_enabled, plant.test_current_A, meter.resistance) == (True, 1e-3, 1234.5)
    meter.resistance_range_auto_enabled = True
    plant.resistance_ohm = 1.5e5
    assert (meter.resistance, plant.test_current_A) == (1.5e5, 1e-5)
    meter.resistance_range = 2e4
    assert meter.resistance == 9.9e37
    plant.resistance_ohm = 1000.0
    meter.source_mode = "current"
    meter.source_current = 5e-4
    meter.compliance_voltage = 10.0
    everything = meter.measure_all()
    assert [everything[name] for name in ("voltage", "current", "resistance")] == [0.5, 5e-4, 1000.0]
    assert (meter.current, meter.voltage) == (5e-4, 0.5)
    kept(meter, wires=4, trigger_count=2, filter_count=5)
    meter.auto_output_off_enabled = False
    meter.disable_source()
    assert meter.check_errors() == []
    assert plant.test_current_A == 0.0


def exercise_keithley2450(meter: Any, plant: StillPlant) -> None:
    assert "MODEL 2450" in meter.id
    plant.resistance_ohm = 1234.5
    meter.measure_resistance(nplc=0.1, resistance=2e3, auto_range=False)
    kept(meter, wires=4)
    assert (meter.resistance_range, meter.resistance_nplc) == (2e3, 0.1)
    meter.enable_source()
    assert (meter.resistance, plant.test_current_A) == (1234.5, 1e-3)
    meter.source_mode = "current"
    meter.source_current = 5e-4
    kept(meter, compliance_voltage=10.0)
    meter.measure_voltage(nplc=0.1, voltage=2.0, auto_range=False)
    assert meter.voltage == pytest.approx(0.61725)
    meter.disable_source()
    assert not int(meter.ask("OUTP?"))
    assert plant.test_current_A == 0.0


def exercise_ldc500(controller: Any, plant: StillPlant) -> None:
    assert controller.id.startswith("Stanford Research Systems,LDC501")
    tec = controller.tec
    tec.mode = "CC"
    kept(tec, current_limit=3.0, current_setpoint=-1.25, enabled=True)
    assert (plant.current_A, tec.current, tec.voltage) == (-1.25, -1.25, -2.5)
    tec.current_limit = 1.0
    assert (tec.current_setpoint, plant.current_A) == (-1.0, -1.0)
    kept(tec, temperature_limits=(10.0, 90.0))
    with pytest.raises(Exception, match=r"\[1, 0\]"):
        tec.temperature_setpoint = 95.0
    kept(tec, temperature_setpoint=42.5)
    tec.mode = "CT"
    assert tec.temperature_setpoint == 25.0
    plant.temperature_degC = 31.25
    assert (tec.temperature, tec.thermometer_type) == (31.25, 3)
    tec.enabled = False
    assert controller.check_errors() == [0, 0]
    assert plant.current_A == 0.0


PYMEASURE = {  # module and class, the ends of what is read and written, and what is done with it
    "keithley2000": ("keithley.Keithley2000", "\n", "\r", exercise_keithley2000),
    "hp34401a": ("hp.HP34401A", "\r\n", "\n", exercise_hp34401a),
    "keithley2400": ("keithley.Keithley2400", "\n", "\r", exercise_keithley2400),
    "keithley2450": ("keithley.Keithley2450", "\n", "\n", exercise_keithley2450),
    "srs_ldc500": ("srs.LDC500Series", "\r\n", "\n", exercise_ldc500),
}


@pytest.mark.parametrize("name", PYMEASURE)
def test_pymeasure(name: str, serve: Serve, plant: StillPlant) -> None:
    kind, read_end, write_end, exercise = PYMEASURE[name]
    module, _, kind = kind.partition(".")
    pytest.importorskip("pyvisa_py", reason="pyvisa-py is not installed")
    package = pytest.importorskip(f"pymeasure.instruments.{module}", reason="PyMeasure is not installed")
    emulator = emulated(name, plant)
    instrument = getattr(package, kind)(
        f"ASRL{serve(emulator)}::INSTR",
        visa_library="@py",
        read_termination=read_end,
        write_termination=write_end,
        timeout=5000,
    )
    try:
        exercise(instrument, plant)
    finally:
        instrument.adapter.close()


# ---- QCoDeS, in a process of its own ----------------------------------------------------------------


def test_qcodes_drivers(plant: StillPlant, tmp_path: Path) -> None:
    if find_spec("qcodes") is None:
        pytest.skip("QCoDeS is not installed")
    plant.resistance_ohm, plant.voltage_V, plant.temperature_degC = 123.456, -0.25, 61.7
    controller = LakeShore(plant, model="336")
    controller.values["MOUT", 1] = (40.0,)
    client = Path(__file__).with_name("qcodes_client.py")
    instruments = {
        "k2000": emulated("keithley2000", plant),
        "k2450": emulated("keithley2450", plant),
        "lakeshore": controller,
    }
    with PseudoTerminals(instruments) as terminals:
        done = subprocess.run(
            [sys.executable, str(client), *(terminals.paths[name] for name in instruments)],
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, "HOME": str(tmp_path)},  # it writes its configuration and logs there
        )
    assert done.returncode == 0, done.stderr[-2000:]
    assert plant.current_A == 0.0
    assert plant.test_current_A == 0.0


# ---- mecompyapi, sciglob ----------------------------------------------------------------------------


def test_mecompyapi(serve: Serve, plant: StillPlant, monkeypatch: pytest.MonkeyPatch) -> None:
    stub = types.ModuleType("ftd2xx")  # its import dies without the vendor's library
    stub.FTD2XX = object  # type: ignore[attr-defined]
    stub.defines = types.ModuleType("defines")  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ftd2xx", stub)
    tec_module = pytest.importorskip("mecompyapi.tec", reason="mecompyapi is not installed")
    tec = tec_module.MeerstetterTEC()
    tec.connect_serial_port(port=serve(emulated("meerstetter", plant)), instance=1)
    assert tec.get_id() == "Meerstetter,TEC1091,112,120,610"
    assert tec.address == 1
    assert tec.get_firmware_identification_string() == "8065-TEC SW G01     "
    assert tec.get_device_status() is tec_module.DeviceStatus.READY
    tec.set_temperature(33.0)
    assert tec.get_setpoint_temperature() == 33.0
    assert tec.get_temperature() == 25.0
    assert tec.get_sink_temperature() == 20.0
    tec.set_current_limitation(2.5)
    assert tec.get_current_limitation() == 2.5
    for name, value in (("proportional_gain", 22.0), ("integration_time", 45.0), ("differential_time", 0.5)):
        getattr(tec, f"set_{name}")(value)
        assert getattr(tec, f"get_{name}")() == value
    assert not tec.is_temperature_stable()
    tec.enable()
    time.sleep(0.3)
    assert tec.get_device_status() is tec_module.DeviceStatus.RUN
    assert plant.current_A == 2.5
    assert tec.get_tec_current() == 2.5
    assert tec.get_all_settings()["object_temperature"] == 25.0
    assert tec.get_monitor_data_logger()
    tec.disable()
    assert plant.current_A == 0.0
    with pytest.raises(tec_module.ComCommandException):
        tec.mecom_basic_cmd.get_float_value(address=1, parameter_id=1234, instance=1)
    tec.tear()


@pytest.fixture
def sciglob() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip(
            "sciglob.devices.temperature_controller", reason="sciglob is not installed", exc_type=ImportError
        )


@pytest.mark.parametrize(("kind", "model"), [("TETech2", "tc-36-25"), ("TETech1", "tc-48-20")])
def test_sciglob(sciglob: Any, serve: Serve, plant: StillPlant, kind: str, model: str) -> None:
    tec = sciglob.TemperatureController(port=serve(emulated("te_technology", plant, model=model)), controller_type=kind)
    tec.connect()
    try:
        plant.temperature_degC = -12.3
        plant.sink_degC = 21.5
        assert tec.get_temperature() == -12.3
        assert tec.get_secondary_temperature() == 21.5
        assert tec.set_temperature(40.5)
        assert tec.get_setpoint() == 40.5
        assert tec.set_pid(12.5, 0.5)
        assert (tec.get_proportional_bandwidth(), tec.get_integral_gain()) == (12.5, 0.5)
        assert tec.enable_output()
        time.sleep(0.3)
        tec.get_temperature()
        assert plant.current_A > 0.0
        assert tec.disable_output()
        assert plant.current_A == 0.0
        assert "XXXX" in tec.send_command("*00010000000099" if kind == "TETech2" else "*0199")
    finally:
        tec.disconnect()


def test_sciglob_on_meerstetter(sciglob: Any, serve: Serve, plant: StillPlant) -> None:
    tec = sciglob.TemperatureController(port=serve(emulated("meerstetter", plant)), controller_type="TETech1090")
    tec.connect()
    try:
        plant.temperature_degC = 31.25
        assert tec.get_object_temperature() == 31.25
        assert tec.get_sink_temperature() == 20.0
        assert tec.set_temperature(40.0)
        assert tec.get_setpoint() == 40.0
        assert tec.enable_output()
        time.sleep(0.3)
        tec.get_object_temperature()
        assert plant.current_A > 0.0
        assert tec.disable_output()
        assert plant.current_A == 0.0
    finally:
        tec.disconnect()


class SciglobsMeerstetter(Answering):
    """sciglob's own TETech 1090. It answers every question with sequence number 0."""

    def __init__(self, responder: Callable[[bytes], str | None]) -> None:
        super().__init__()
        self._responder = responder

    def receive(self, data: bytes, time_s: float) -> None:
        if (answer := self._responder(data)) is not None:
            self.answer(time_s + 0.005, answer.encode())


def test_our_mecom_on_sciglobs_meerstetter(sciglob: Any, attach: Serve, clock: VirtualClock) -> None:
    """It knows neither our emulator nor our idea of the protocol."""
    address = attach(SciglobsMeerstetter(sciglob._Simulated1090Responder(object_temp=19.6, device_type=1090)))

    def linked(ask: Callable[[MecomLink], Any]) -> Any:
        """The answer on a link whose next question has the number 0, the only one that is answered."""
        link = MecomLink(Transport(open_port(address, LineSettings()), clock), first_token=0xFFFF)  # type: ignore[arg-type]
        try:
            return ask(link)
        finally:
            link.transport.close()

    assert linked(lambda link: link.read_int(100)) == 1090
    assert linked(lambda link: link.read_float(1000)) == pytest.approx(19.6)
    linked(lambda link: link.write_float(3000, 31.5))
    assert linked(lambda link: link.read_float(3000)) == 31.5
    with pytest.raises(Refused):
        linked(lambda link: link.read_float(1234))
    with pytest.raises(TimedOut):  # a right answer with another question's number is none
        linked(lambda link: (link.read_int(100), link.read_float(1000)))


# ---- the makers' and others' own packages -------------------------------------------------------------


@pytest.fixture
def makers_client(plant: StillPlant, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    pytest.importorskip("lakeshore", reason="lakeshore is not installed")
    from lakeshore import Model335, generic_instrument

    with PseudoTerminals({"it": LakeShore(plant, update_s=0.0)}) as terminals:
        path = terminals.paths["it"]
        port = types.SimpleNamespace(device=path, vid=0x1FB9, pid=0x0300, serial_number="335A123")
        monkeypatch.setattr(generic_instrument, "comports", lambda: [port])
        client = Model335(57600)
        yield client
        client.disconnect_usb()


def test_makers_client(makers_client: Any, plant: StillPlant) -> None:
    from lakeshore import InstrumentException

    model = makers_client
    assert (model.model_number, model.serial_number) == ("MODEL335", "335A123")
    plant.temperature_degC = 61.7
    assert model.get_celsius_reading("A") == 61.7
    assert model.get_all_kelvin_reading() == [334.85, 293.15]
    assert not model.get_input_reading_status("A").invalid_reading
    model.set_heater_setup_one(model.HeaterResistance.HEATER_50_OHM, 0.5, model.HeaterOutputDisplay.POWER)
    assert model.get_heater_setup(1)["max_current"] == 0.5
    model.set_heater_output_mode(1, model.HeaterOutputMode.OPEN_LOOP, model.InputSensor.CHANNEL_A)
    assert model.get_heater_output_mode(1)["mode"] == model.HeaterOutputMode.OPEN_LOOP
    for name, value in (("manual_output", 40.0), ("heater_range", model.HeaterRange.HIGH), ("control_setpoint", 320.0)):
        getattr(model, f"set_{name}")(1, value)
        assert getattr(model, f"get_{name}")(1) == value
    assert plant.current_A == pytest.approx(0.4)
    assert (model.get_heater_output(1), model.get_heater_status(1)) == (40.0, model.HeaterError.NO_ERROR)
    model.set_temperature_limit("A", 400.0)
    assert model.get_temperature_limit("A") == 400.0
    model.set_setpoint_ramp_parameter(1, True, 10.5)
    assert model.get_setpoint_ramp_parameter(1) == {"ramp_enable": True, "rate_value": 10.5}
    model.set_heater_pid(1, 40.0, 30.0, 10.0)
    assert model.get_heater_pid(1) == {"gain": 40.0, "integral": 30.0, "derivative": 10.0}
    with pytest.raises(InstrumentException, match="Execution"):
        model.command("RANGE 1,9")
    with pytest.raises(InstrumentException, match="Command"):
        model.command("BOGUS")
    model.all_heaters_off()
    assert plant.current_A == 0.0


@pytest.fixture
def others_client(plant: StillPlant, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    package = pytest.importorskip("tclab", reason="tclab is not installed")
    module = package.tclab
    with PseudoTerminals({"board": TcLab(plant)}) as terminals:
        path = terminals.paths["board"]
        ports = types.SimpleNamespace(comports=lambda: [(path, "a board", "USB VID:PID=16D0:0613")])
        monkeypatch.setattr(module, "list_ports", ports)
        monkeypatch.setattr(module, "time", types.SimpleNamespace(sleep=lambda seconds: None))  # no board starts here
        lab = module.TCLab()
        yield lab
        lab.close()


def test_others_client(others_client: Any, plant: StillPlant) -> None:
    lab = others_client
    assert lab.version == "TCLab Firmware 1.4.0 Arduino Uno"
    plant.temperature_degC, plant.sink_degC = 61.7, 20.0
    assert (lab.T1, lab.T2) == (61.52, 19.94)
    assert lab.Q1(37.5) == 37.5
    assert plant.current_A == pytest.approx(75 / 200)
    assert lab.Q1() == 37.5
    lab.P1 = 255
    assert lab.P1 == 255.0
    assert lab.Q2(120) == 100.0
    assert lab.scan() == (61.52, 19.94, 37.5, 100.0)
    assert lab.LED(50) == 50.0
    assert lab.Q1(0) == 0.0
    assert plant.current_A == 0.0


# ---- our own --------------------------------------------------------------------------------------------

# a terminal has no other framing; the emulated board is not restarted
ON_A_TERMINAL = {"tclab": {"boot_s": 0.0}, "lakeshore": {"framing": "8N1"}, "hp34401a": {"framing": "8N1"}}


@pytest.mark.parametrize("name", sorted(registry.DRIVERS))
def test_our_own_drivers_on_a_pseudo_terminal(name: str, serve: Serve, plant: StillPlant) -> None:
    """By real time and a real port, which has no virtual line to hold it up."""
    is_meter = name in registry.METERS
    open_one: Any = open_meter if is_meter else open_controller
    driver = open_one(name, serve(emulated(name, plant)), RealClock(), **ON_A_TERMINAL.get(name, {}))
    assert is_meter or driver.off()
    driver.identify()
    if is_meter:
        driver.configure(True, 0.2, 1e-3)
        assert (driver.read().value, plant.test_current_A) == (1e4, 1e-5)
    else:
        driver.configure(0.9, (10.0, 95.0), 5.0)
        driver.arm_current() if driver.commands_current else driver.arm_setpoint()
        if driver.commands_current:
            driver.set_current_A(0.5)
        assert driver.read_temperature().value == pytest.approx(25.0, abs=0.33 if name == "tclab" else 0.0)
        assert driver.status().output_is_on
    assert driver.off()
    assert (plant.current_A, plant.test_current_A) == (0.0, 0.0)
    driver.close()
