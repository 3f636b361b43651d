"""QCoDeS' Keithley 2000, Keithley 2450 and Lake Shore 336 drive the emulators, from a process of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.keithley2000 import Keithley2000
from sim.instruments.keithley2450 import Keithley2450
from sim.instruments.lakeshore import LakeShore
from tests.rig.drivers.still_plant import StillPlant


def test_qcodes_drivers(plant: StillPlant, tmp_path: Path) -> None:
    if find_spec("qcodes") is None:
        pytest.skip("QCoDeS is not installed")
    plant.resistance_ohm, plant.voltage_V, plant.temperature_degC = 123.456, -0.25, 61.7
    controller = LakeShore(plant, model="336")
    controller.outputs[1].manual_percent = 40.0
    client = Path(__file__).with_name("qcodes_client.py")
    instruments = {"k2000": Keithley2000(plant), "k2450": Keithley2450(plant), "lakeshore": controller}
    with PseudoTerminals(instruments) as terminals:
        done = subprocess.run(
            [sys.executable, str(client), *(terminals.paths[name] for name in instruments)],
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, "HOME": str(tmp_path)},  # it writes its configuration and logs there
        )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    meter = found["keithley2000"]
    assert "2000" in meter["model"]
    for mode in ("2w resistance", "4w resistance"):
        assert meter[mode] == {"nplc": 0.1, "range": 1000.0, "amplitude": 123.456}
    assert meter["automatic"] == {"on": True, "amplitude": 123.456}
    assert meter["volts"] == -0.25
    assert found["keithley2450"] == {
        "model": "2450",
        "four_wire": True,
        "nplc": "0.1",
        "range": 2000.0,
        "automatic": False,
        "off": True,
        "resistance": 123.456,
        "on": False,
    }
    assert found["lakeshore336"] == {
        "model": "336",
        "kelvin": 334.85,
        "status": "OK",
        "units": "kelvin",
        "limit_K": 400.0,
        "mode": "open_loop",
        "range": "high",
        "percent": 40.0,
    }
    assert plant.current_A == 0.0
    assert plant.test_current_A == 0.0
