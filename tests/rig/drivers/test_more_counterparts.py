"""Independent software on a pseudo-terminal or in process: PyMeasure and sciglob against the emulators."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rig.core.clock import RealClock
from rig.drivers import registry
from rig.drivers.registry import open_controller, open_meter
from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.instrument import Instrument
from sim.instruments.registry import emulated_controller, emulated_meter
from tests.rig.drivers.still_plant import StillPlant

pytestmark = pytest.mark.filterwarnings("ignore")


def pymeasure_class(module: str, name: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("pyvisa_py", reason="pyvisa-py is not installed")
        return getattr(
            pytest.importorskip(f"pymeasure.instruments.{module}", reason="PyMeasure is not installed"), name
        )


@pytest.fixture
def temperature_controller() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        module = pytest.importorskip(
            "sciglob.devices.temperature_controller", reason="sciglob is not installed", exc_type=ImportError
        )
    return module.TemperatureController


@pytest.fixture
def serve(plant: StillPlant) -> Iterator[Callable[[Instrument], str]]:
    """Put an instrument on a pseudo-terminal: its path."""
    open_terminals: list[PseudoTerminals] = []

    def put(instrument: Instrument) -> str:
        terminals = PseudoTerminals({"it": instrument})
        terminals.start()
        open_terminals.append(terminals)
        return terminals.paths["it"]

    yield put
    for terminals in open_terminals:
        terminals.stop()


Serve = Callable[[Instrument], str]


def exercise_hp34401a(meter: Any, plant: StillPlant) -> None:
    meter.remote_control_enabled = True
    assert meter.id.startswith("HEWLETT-PACKARD,34401A")
    plant.resistance_ohm = 123.456
    for function in ("R2W", "R4W"):
        meter.function_ = function
        assert meter.function_ == function
        meter.range_ = 1000
        assert (meter.range_, meter.autorange) == (1e3, False)
        meter.nplc = 0.2
        assert meter.nplc == 0.2
        assert plant.test_current_A == 1e-3
        assert meter.reading == 123.456
    meter.init_trigger()
    assert meter.stored_reading == 123.456
    assert meter.stored_readings_count == 1
    meter.sample_count = 3
    assert list(meter.reading) == [123.456] * 3
    plant.resistance_ohm = math.inf
    assert list(meter.reading) == [9.9e37] * 3
    plant.resistance_ohm = 77.0
    assert meter.resistance_4w == 77.0
    meter.autozero_enabled = False
    assert meter.autozero_enabled is False
    meter.autorange = True
    assert meter.autorange is True
    assert (meter.terminals_used, meter.scpi_version) == ("FRONT", 1991.0)
    meter.beep()
    assert meter.ask("SYST:ERR?").strip() == '+0,"No error"'
    meter.remote_control_enabled = False


def exercise_keithley2400(meter: Any, plant: StillPlant) -> None:
    assert "MODEL 2400" in meter.id
    meter.reset()
    plant.resistance_ohm = 1234.5
    meter.measure_resistance(nplc=0.1, resistance=2e3, auto_range=False)
    assert meter.resistance_range == 2e3
    assert meter.resistance_mode_auto_enabled is False
    meter.resistance_mode_auto_enabled = True
    meter.enable_source()
    assert meter.source_enabled is True
    assert plant.test_current_A == 1e-3
    assert meter.resistance == 1234.5
    meter.resistance_range_auto_enabled = True
    plant.resistance_ohm = 1.5e5
    assert meter.resistance == 1.5e5
    assert plant.test_current_A == 1e-5
    meter.resistance_range = 2e4
    assert meter.resistance == 9.9e37
    plant.resistance_ohm = 1000.0
    meter.source_mode = "current"
    meter.source_current = 5e-4
    meter.compliance_voltage = 10.0
    everything = meter.measure_all()
    assert everything["voltage"] == 0.5
    assert everything["current"] == 5e-4
    assert everything["resistance"] == 1000.0
    assert meter.current == 5e-4
    assert meter.voltage == 0.5
    meter.wires = 4
    assert meter.wires == 4
    meter.trigger_count = 2
    assert meter.trigger_count == 2
    meter.filter_count = 5
    assert meter.filter_count == 5
    meter.auto_output_off_enabled = False
    meter.disable_source()
    assert meter.check_errors() == []
    assert plant.test_current_A == 0.0


def exercise_ldc500(controller: Any, plant: StillPlant) -> None:
    assert controller.id.startswith("Stanford Research Systems,LDC501")
    tec = controller.tec
    tec.mode = "CC"
    tec.current_limit = 3.0
    assert tec.current_limit == 3.0
    tec.current_setpoint = -1.25
    assert tec.current_setpoint == -1.25
    tec.enabled = True
    assert tec.enabled is True
    assert plant.current_A == -1.25
    assert (tec.current, tec.voltage) == (-1.25, -2.5)
    tec.current_limit = 1.0
    assert (tec.current_setpoint, plant.current_A) == (-1.0, -1.0)
    tec.temperature_limits = (10.0, 90.0)
    assert tec.temperature_limits == (10.0, 90.0)
    with pytest.raises(Exception, match=r"\[1, 0\]"):
        tec.temperature_setpoint = 95.0
    tec.temperature_setpoint = 42.5
    assert tec.temperature_setpoint == 42.5
    tec.mode = "CT"
    assert tec.temperature_setpoint == 25.0
    plant.temperature_degC = 31.25
    assert tec.temperature == 31.25
    assert tec.thermometer_type == 3
    tec.enabled = False
    assert controller.check_errors() == [0, 0]
    assert plant.current_A == 0.0


PYMEASURE = {
    "hp34401a": ("hp", "HP34401A", "\r\n", "\n", exercise_hp34401a),
    "keithley2400": ("keithley", "Keithley2400", "\n", "\r", exercise_keithley2400),
    "srs_ldc500": ("srs", "LDC500Series", "\r\n", "\n", exercise_ldc500),
}


def emulator(name: str, plant: StillPlant) -> Instrument:
    return emulated_controller(name, plant) if name == "srs_ldc500" else emulated_meter(name, plant)


def exercise(name: str, address: str, plant: StillPlant) -> None:
    module, kind, read_end, write_end, action = PYMEASURE[name]
    instrument = pymeasure_class(module, kind)(
        f"ASRL{address}::INSTR",
        visa_library="@py",
        read_termination=read_end,
        write_termination=write_end,
        timeout=2000,
    )
    try:
        action(instrument, plant)
    finally:
        instrument.adapter.close()


@pytest.mark.parametrize("name", PYMEASURE)
def test_pymeasure(name: str, serve: Serve, plant: StillPlant) -> None:
    exercise(name, serve(emulator(name, plant)), plant)


@pytest.mark.parametrize(("kind", "model"), [("TETech2", "tc-36-25"), ("TETech1", "tc-48-20")])
def test_sciglob(temperature_controller: Any, serve: Serve, plant: StillPlant, kind: str, model: str) -> None:
    tec = temperature_controller(
        port=serve(emulated_controller("te_technology", plant, model=model)), controller_type=kind
    )
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


def test_sciglob_on_meerstetter(temperature_controller: Any, serve: Serve, plant: StillPlant) -> None:
    tec = temperature_controller(port=serve(emulated_controller("meerstetter", plant)), controller_type="TETech1090")
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


@pytest.mark.parametrize("name", sorted(registry.CONTROLLERS))
def test_our_own_controllers_on_a_pseudo_terminal(name: str, serve: Serve, plant: StillPlant) -> None:
    """By real time and a real port, which has no virtual line to hold it up."""
    options = {"boot_s": 0.0} if name == "tclab" else {"framing": "8N1"} if name == "lakeshore" else {}
    controller = open_controller(name, serve(emulated_controller(name, plant)), RealClock(), **options)
    assert controller.off()
    controller.identify()
    controller.configure(0.9, (10.0, 95.0), 5.0)
    if controller.commands_current:
        controller.arm_current()
        controller.set_current_A(0.5)
    else:
        controller.arm_setpoint()
    assert controller.read_temperature().value == pytest.approx(25.0, abs=0.33 if name == "tclab" else 0.0)
    assert controller.status().output_is_on
    assert controller.off()
    assert plant.current_A == 0.0
    controller.close()


@pytest.mark.parametrize("name", sorted(registry.METERS))
def test_our_own_meters_on_a_pseudo_terminal(name: str, serve: Serve, plant: StillPlant) -> None:
    options = {"framing": "8N1"} if name == "hp34401a" else {}  # a terminal has no other
    meter = open_meter(name, serve(emulated_meter(name, plant)), RealClock(), **options)
    meter.identify()
    meter.configure(True, 0.2, 1e-3)
    assert meter.read().value == 1e4
    assert plant.test_current_A == 1e-5
    assert meter.off()
    assert plant.test_current_A == 0.0
    meter.close()
