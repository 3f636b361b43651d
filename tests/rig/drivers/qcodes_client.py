"""QCoDeS' drivers, in a process of their own: `python qcodes_client.py K2000 K2450 LAKESHORE`, a terminal each."""

from __future__ import annotations

import sys

import pytest


def keithley2000(address: str) -> None:
    from qcodes.instrument_drivers.Keithley import Keithley2000

    meter = Keithley2000("k2000", address, visalib="@py", terminator="\n")
    meter.trigger_continuous(True)
    assert "2000" in meter.get_idn()["model"]
    for mode in ("2w resistance", "4w resistance"):
        meter.mode(mode)
        meter.nplc(0.1)
        meter.range(1e3)
        assert (meter.mode(), meter.nplc(), meter.range(), meter.amplitude()) == (mode, 0.1, 1000.0, 123.456)
    meter.auto_range_enabled(True)
    assert (meter.auto_range_enabled(), meter.amplitude()) == (True, 123.456)
    meter.mode("dc voltage")
    assert meter.amplitude() == -0.25
    meter.close()


def keithley2450(address: str) -> None:
    from qcodes.instrument_drivers.Keithley import Keithley2450

    meter = Keithley2450("k2450", address, visalib="@py", terminator="\n")
    assert meter.get_idn()["model"] == "2450"
    meter.sense_function("resistance")
    sense = meter.sense
    sense.four_wire_measurement(True)
    sense.nplc(0.1)
    sense.range(2e3)
    assert (sense.four_wire_measurement(), sense.nplc(), sense.range()) == (True, "0.1", 2000.0)
    assert sense.auto_range() is False
    with pytest.raises(RuntimeError, match="Output needs to be on"):
        sense.resistance()
    meter.output_enabled(True)
    assert sense.resistance() == 123.456
    meter.output_enabled(False)
    assert meter.output_enabled() is False
    meter.close()


def lakeshore336(address: str) -> None:
    from qcodes.instrument_drivers.Lakeshore import LakeshoreModel336

    controller = LakeshoreModel336("ls", address, visalib="@py", terminator="\r\n")
    assert controller.get_idn()["model"] == "336"
    sensor, output = controller.A, controller.output_1
    assert (sensor.temperature(), sensor.sensor_status(), sensor.units()) == (334.85, "OK", "kelvin")
    sensor.t_limit(400.0)
    assert sensor.t_limit() == 400.0
    output.mode("open_loop")
    output.output_range("high")
    assert (output.mode(), output.output_range(), output.output()) == ("open_loop", "high", 40.0)
    output.output_range("off")
    controller.close()


if __name__ == "__main__":
    for client, path in zip((keithley2000, keithley2450, lakeshore336), sys.argv[1:], strict=True):
        client(f"ASRL{path}::INSTR")
