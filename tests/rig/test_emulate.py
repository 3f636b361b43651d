"""`emulate`: its lines, and the rig itself as a client on its pseudo-terminals, in real time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rig.clock import RealClock
from rig.drivers.registry import open_controller, open_meter
from rig.errors import PortHeld
from rig.ports.open import LineSettings, open_port
from tests.rig.small import write_bench

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals need POSIX")


def test_the_rig_drives_what_emulate_serves(tmp_path: Path, root: Path) -> None:
    path = write_bench(tmp_path)
    process = subprocess.Popen(
        [sys.executable, "-m", "rig", "emulate", str(path), "--speed", "5"],
        cwd=root,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        words = [process.stdout.readline().split() for _ in range(2)]
        assert [line[:2] for line in words] == [["controller", "meerstetter"], ["meter", "keithley2000"]]
        clock = RealClock()
        controller = open_controller("meerstetter", words[0][2], clock)
        with pytest.raises(PortHeld):
            open_port(words[0][2], LineSettings())
        assert controller.identify().maker == "Meerstetter"
        assert controller.off()
        controller.configure(4.0, (10.0, 95.0), 5.0)
        controller.arm_current()
        controller.set_current_A(2.0)
        before = controller.read_temperature().value
        meter = open_meter("keithley2000", words[1][2], clock)
        assert meter.identify().model.endswith("2000")
        meter.configure(True, 0.1, 1e-3)
        readings = [meter.read_resistance() for _ in range(4)]
        assert readings[-1].is_number
        assert 1e3 < readings[-1].value < 1e6
        assert controller.read_temperature().value > before + 0.1
        assert controller.off()
        controller.close()
        meter.close()
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=10.0)
    assert out == ""
    assert process.returncode == 128 + signal.SIGINT, err
