"""Clocks, readings, errors."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest

from rig.core.clock import RealClock, VirtualClock
from rig.core.errors import (
    Corrupt,
    Disconnected,
    InstrumentError,
    OutOfStep,
    PortHeld,
    Refused,
    RigError,
    TimedOut,
)
from rig.core.reading import Quality, Reading, missing
from rig.drivers.registry import open_controller, open_meter


def test_virtual_time_passes_only_by_sleeping() -> None:
    clock = VirtualClock(5.0)
    assert clock.now_s() == 5.0
    clock.sleep_until_s(8.0)
    clock.sleep_until_s(7.0)
    assert clock.now_s() == 8.0


def test_real_time() -> None:
    clock = RealClock()
    begin_s = clock.now_s()
    clock.sleep_until_s(begin_s + 0.01)
    clock.sleep_until_s(begin_s - 1.0)
    assert 0.01 <= clock.now_s() - begin_s < 0.5


def test_reading() -> None:
    assert Reading(1.0, 2.0).is_number
    assert Reading(1.0, 2.0, Quality.SETTLING).is_number
    for quality in (Quality.OVERRANGE, Quality.INVALID, Quality.STALE, Quality.MISSING):
        assert not Reading(1.0, 2.0, quality).is_number
    assert math.isnan(missing(3.0).value)
    with pytest.raises(AttributeError):
        Reading(1.0, 2.0).value = 3.0  # type: ignore[misc]


def test_one_error_tree() -> None:
    for error in (TimedOut("x"), Corrupt("x"), OutOfStep("x"), Refused(5, "no"), Disconnected("x")):
        assert isinstance(error, InstrumentError)
    assert issubclass(InstrumentError, RigError)
    assert not isinstance(PortHeld("p"), InstrumentError)
    assert str(PortHeld("/dev/x", 12, "cat")) == "/dev/x is held by process 12 (cat)"
    assert str(Refused(5, "no")) == "no (error 5)"


@pytest.mark.parametrize("open_driver", [open_controller, open_meter])
def test_unknown_driver(open_driver: object) -> None:
    with pytest.raises(ValueError, match="'toaster' is not known"):
        open_driver("toaster", "sim://x", VirtualClock())  # type: ignore[operator]


def test_only_the_driver_that_is_asked_for_is_imported() -> None:
    script = (
        "import sys, rig.drivers.registry as r; from rig.core.clock import VirtualClock\n"
        "try: r.open_controller('meerstetter', 'sim://nobody', VirtualClock())\n"
        "except Exception: pass\n"
        "print('rig.drivers.meerstetter' in sys.modules, 'rig.drivers.keithley2000' in sys.modules,"
        " 'sim.instruments.keithley2000' in sys.modules, 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False", "False", "False"]
