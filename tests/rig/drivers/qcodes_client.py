"""QCoDeS' drivers, in a process of their own: `python qcodes_client.py K2000 K2450 LAKESHORE`, a terminal each, prints
what they have read, as JSON."""

from __future__ import annotations

import json
import sys
from typing import Any


def keithley2000(address: str) -> dict[str, Any]:
    from qcodes.instrument_drivers.Keithley import Keithley2000

    meter = Keithley2000("k2000", address, visalib="@py", terminator="\n")
    meter.trigger_continuous(True)
    found: dict[str, Any] = {"model": meter.get_idn()["model"]}
    for mode in ("2w resistance", "4w resistance"):
        meter.mode(mode)
        assert meter.mode() == mode
        meter.nplc(0.1)
        meter.range(1e3)
        found[mode] = {"nplc": meter.nplc(), "range": meter.range(), "amplitude": meter.amplitude()}
    meter.auto_range_enabled(True)
    found["automatic"] = {"on": meter.auto_range_enabled(), "amplitude": meter.amplitude()}
    meter.mode("dc voltage")
    found["volts"] = meter.amplitude()
    meter.close()
    return found


def keithley2450(address: str) -> dict[str, Any]:
    from qcodes.instrument_drivers.Keithley import Keithley2450

    meter = Keithley2450("k2450", address, visalib="@py", terminator="\n")
    found: dict[str, Any] = {"model": meter.get_idn()["model"]}
    meter.sense_function("resistance")
    sense = meter.sense
    sense.four_wire_measurement(True)
    sense.nplc(0.1)
    sense.range(2e3)
    found |= {"four_wire": sense.four_wire_measurement(), "nplc": sense.nplc(), "range": sense.range()}
    found["automatic"] = sense.auto_range()
    try:
        sense.resistance()
    except RuntimeError as error:
        found["off"] = "Output needs to be on" in str(error)
    meter.output_enabled(True)
    found["resistance"] = sense.resistance()
    meter.output_enabled(False)
    found["on"] = meter.output_enabled()
    meter.close()
    return found


def lakeshore336(address: str) -> dict[str, Any]:
    from qcodes.instrument_drivers.Lakeshore import LakeshoreModel336

    controller = LakeshoreModel336("ls", address, visalib="@py", terminator="\r\n")
    found: dict[str, Any] = {"model": controller.get_idn()["model"], "kelvin": controller.A.temperature()}
    found |= {"status": controller.A.sensor_status(), "units": controller.A.units()}
    controller.A.t_limit(400.0)
    found["limit_K"] = controller.A.t_limit()
    output = controller.output_1
    output.mode("open_loop")
    output.output_range("high")
    found |= {"mode": output.mode(), "range": output.output_range(), "percent": output.output()}
    output.output_range("off")
    controller.close()
    return found


def main(paths: list[str]) -> None:
    clients = (keithley2000, keithley2450, lakeshore336)
    found = {client.__name__: client(f"ASRL{path}::INSTR") for client, path in zip(clients, paths, strict=True)}
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
