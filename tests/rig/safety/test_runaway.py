"""Without a known plate, or without a current: the coarse watch."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from rig.core.outcome import Tripped
from rig.safety.plate_watch import RunawayWatch

CLEAN = ("peltier_8010.csv", "peltier_8020.csv", "peltier_8055.csv", "peltier_500.csv")


def replayed(path: Path) -> Tripped | None:
    """What a measured record (time, temperature, duty) trips on."""
    watch, sent = RunawayWatch(1.0, 20.0), 0.0
    for time_s, temperature_degC, duty in np.genfromtxt(path, delimiter=",", skip_header=1):
        try:
            watch.look(time_s, temperature_degC, sent, math.nan)
        except Tripped as trip:
            return trip
        sent = duty
    return None


def test_measured_records(measured: Path) -> None:
    """Clean runs pass; a saturated heat sink is seen."""
    for name in CLEAN:
        assert replayed(measured / name) is None, name
    trip = replayed(measured / "peltier_runaway.csv")
    assert trip is not None
    assert trip.time_s < 400.0
    assert "saturated heat sink" in str(trip)


def test_a_heater_that_is_open() -> None:
    watch = RunawayWatch(4.0, 20.0)
    for k in range(101):
        watch.look(0.2 * k, 25.0, 3.0 if k else 0.0, math.nan)
    with pytest.raises(Tripped, match="is the plate connected") as trip:
        watch.look(21.0, 25.0, 3.0, math.nan)
    assert trip.value.cause == "no_response"


def test_an_instruments_own_regulation_that_runs_the_wrong_way() -> None:
    watch = RunawayWatch(4.0, 20.0)
    for k in range(100):
        watch.look(0.2 * k, 40.0 - 0.01 * k, math.nan, 60.0)
    with pytest.raises(Tripped, match=r"no nearer to the setpoint of 60\.00 degC"):
        watch.look(20.5, 39.0, math.nan, 60.0)
    watch = RunawayWatch(4.0, 20.0)
    for k in range(500):  # a slow one, and one that has arrived
        watch.look(0.2 * k, min(40.0 + 0.02 * k, 59.9), math.nan, 60.0)
