"""QCoDeS' Keithley 2000, in a process of its own: `python qcodes_client.py TTY` prints what it has read, as JSON."""

from __future__ import annotations

import json
import sys


def main(path: str) -> None:
    from qcodes.instrument_drivers.Keithley import Keithley2000

    meter = Keithley2000("meter", f"ASRL{path}::INSTR", visalib="@py", terminator="\n")
    meter.trigger_continuous(True)
    found = {"model": meter.get_idn()["model"]}
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
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
