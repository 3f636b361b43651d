"""QCoDeS' Keithley 2000 drives the emulator, from a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from still_plant import StillPlant

from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.keithley2000 import Keithley2000


def test_qcodes_keithley2000(plant: StillPlant, tmp_path: Path) -> None:
    if find_spec("qcodes") is None:
        pytest.skip("QCoDeS is not installed")
    plant.resistance_ohm, plant.voltage_V = 123.456, -0.25
    client = Path(__file__).with_name("qcodes_client.py")
    with PseudoTerminals({"meter": Keithley2000(plant)}) as terminals:
        done = subprocess.run(
            [sys.executable, str(client), terminals.paths["meter"]],
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, "HOME": str(tmp_path)},  # it writes its configuration and logs there
        )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert "2000" in found["model"]
    for mode in ("2w resistance", "4w resistance"):
        assert found[mode] == {"nplc": 0.1, "range": 1000.0, "amplitude": 123.456}
    assert found["automatic"] == {"on": True, "amplitude": 123.456}
    assert found["volts"] == -0.25
