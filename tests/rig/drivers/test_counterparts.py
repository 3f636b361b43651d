"""Independent software on a pseudo-terminal: PyMeasure and mecompyapi against the emulators."""

from __future__ import annotations

import math
import sys
import time
import types
import warnings
from collections.abc import Iterator
from typing import Any

import pytest

from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.keithley2000 import Keithley2000
from sim.instruments.meerstetter import MeerstetterTec
from tests.rig.drivers.still_plant import StillPlant

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture
def keithley_class() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("pyvisa_py", reason="pyvisa-py is not installed")
        module = pytest.importorskip("pymeasure.instruments.keithley", reason="PyMeasure is not installed")
    return module.Keithley2000


@pytest.fixture
def terminals(plant: StillPlant) -> Iterator[PseudoTerminals]:
    instruments = {"controller": MeerstetterTec(plant), "meter": Keithley2000(plant)}
    with PseudoTerminals(instruments) as serving:
        yield serving


def exercise(meter: Any, plant: StillPlant) -> None:
    """Every call of PyMeasure's class that an ohmmeter has."""
    assert "MODEL 2000" in meter.id
    meter.reset()
    for wires, prefix, mode in ((2, "resistance", "resistance"), (4, "resistance_4W", "resistance 4W")):
        plant.resistance_ohm = 123.456
        meter.measure_resistance(1e3, wires)
        assert meter.mode == mode
        assert getattr(meter, prefix + "_range") == 1e3
        assert meter.resistance == 123.456
        for name, value in (("nplc", 0.1), ("digits", 5), ("reference", 2.5), ("range", 1e5)):
            setattr(meter, f"{prefix}_{name}", value)
            assert getattr(meter, f"{prefix}_{name}") == value
        assert plant.test_current_A == 1e-5
        meter.auto_range()
        assert meter.resistance == 123.456
        assert getattr(meter, prefix + "_range") == 1e3
        plant.resistance_ohm = math.inf
        assert meter.resistance == 9.9e37
        meter.enable_filter()
        meter.disable_filter()
        meter.enable_reference()
        meter.acquire_reference()
        meter.disable_reference()
    plant.resistance_ohm = 77.0
    meter.trigger_count = 3
    assert meter.trigger_count == 3
    assert meter.resistance == [77.0, 77.0, 77.0]
    meter.trigger_delay = 0.25
    assert meter.trigger_delay == 0.25
    meter.beep_state = "enabled"
    assert meter.beep_state == "enabled"
    meter.beep(440, 0.1)
    meter.local()
    meter.remote()
    meter.remote_lock()
    assert meter.check_errors() == []


def test_pymeasure_keithley2000(keithley_class: Any, terminals: PseudoTerminals, plant: StillPlant) -> None:
    meter = keithley_class(
        f"ASRL{terminals.paths['meter']}::INSTR",
        visa_library="@py",
        baud_rate=9600,
        read_termination="\n",
        write_termination="\r",
        timeout=5000,
    )
    exercise(meter, plant)
    meter.adapter.close()


def test_mecompyapi(terminals: PseudoTerminals, plant: StillPlant, monkeypatch: pytest.MonkeyPatch) -> None:
    stub = types.ModuleType("ftd2xx")  # its import dies without the vendor's library
    stub.FTD2XX = object  # type: ignore[attr-defined]
    stub.defines = types.ModuleType("defines")  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ftd2xx", stub)
    tec_module = pytest.importorskip("mecompyapi.tec", reason="mecompyapi is not installed")
    tec = tec_module.MeerstetterTEC()
    tec.connect_serial_port(port=terminals.paths["controller"], instance=1)
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
