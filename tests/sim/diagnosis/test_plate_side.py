"""The plate's side of a diagnosis, on records of a generator that shares no code with it, plates alone."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest

from sim.diagnosis.intervals import intervals
from sim.diagnosis.search import Search
from sim.diagnosis.selection import Selected, drive_moves, selected
from sim.diagnosis.upper_limits import _allowed
from sim.effects.catalogue import catalogue
from sim.inference.joint.starts import plate_fit
from sim.inference.noise import ChannelNoise, Readings, estimate, likelier_of_rounded
from sim.inference.nuisance import resting_K
from sim.inference.record.record import read_columns
from tests.truth import record


def chosen(columns: dict[str, np.ndarray], kind: Literal["peltier", "heater"] = "peltier") -> Selected:
    plate = {name: columns[name] for name in ("time_s", "temperature_degC", "current_A")}
    return selected(read_columns(plate, held_out=False), (kind,), (), Search(list(catalogue().values())))


def test_radiation_is_not_lost_to_a_modules_slopes() -> None:
    """Else a plate that radiates passes for a module whose Seebeck coefficient falls with temperature."""
    loss_per_K3_s = 2e-11
    found = chosen(record(1, {"radiative_loss": {"loss_per_K3_s": loss_per_K3_s}}))
    assert [e.name for e in found.fit.effects] == ["radiative_loss"]
    assert not found.fit.joint.slopes
    value, _ = intervals(found.fit)["radiative_loss"]["loss_per_K3_s"]
    assert value == pytest.approx(loss_per_K3_s, rel=0.3)


def test_a_modules_slopes_are_no_effect() -> None:
    """Else every real module, whose numbers rise with temperature, is said to radiate."""
    rng, time = np.random.default_rng(4), np.arange(3000) * 0.5
    current = np.repeat(rng.uniform(-1.0, 3.0, 30), 100)
    degC, shown = 25.0, []
    for amps in current:
        shown.append(degC)
        for _ in range(10):
            s, r = 1.8e-3 * (1.0 + 0.0015 * (degC - 25.0)), 0.06 * (1.0 + 0.0045 * (degC - 25.0))
            degC += 0.05 * (s * amps * (degC + 273.15) + 0.5 * r * amps**2 - 0.03 * (degC - 23.0))
    columns = {
        "time_s": time,
        "temperature_degC": np.array(shown) + 0.01 * rng.standard_normal(time.size),
        "current_A": current,
    }
    found = chosen(columns)
    assert not found.fit.effects
    assert found.fit.joint.slopes


def test_a_dead_band_is_found_between_its_jumps() -> None:
    """Else a descent that sees no slope leaves the band where it began, and blames something else for the rest."""
    deadband_A, current = 0.15, np.repeat(np.random.default_rng(1).uniform(-0.5, 1.0, 100), 30)
    found = chosen(record(1, {"actuator_deadband": {"deadband_A": deadband_A}}, current=current))
    assert [e.name for e in found.fit.effects] == ["actuator_deadband"]
    _, interval = intervals(found.fit)["actuator_deadband"]["deadband_A"]
    assert interval is not None
    assert interval[0] <= deadband_A <= interval[1]


def test_a_current_that_only_heats_moves_its_plate() -> None:
    """Else a module driven in one direction, whose two coefficients stand for each other, is said not to be driven."""
    rng, time = np.random.default_rng(1), np.arange(900) * 1.0
    duty = np.repeat(rng.uniform(0.5, 0.6, 9), 100)
    degC, shown = 25.0, []
    for u in duty:
        shown.append(degC)
        degC += 1e-3 * u * (degC + 273.15) + 0.5 * 0.2 * u**2 - 0.01 * (degC - 25.0)
    columns = {"time_s": time, "temperature_degC": np.array(shown) + 0.05 * rng.standard_normal(900), "current_A": duty}
    assert drive_moves(plate_fit(read_columns(columns, held_out=False), ("peltier",)))


def test_rounding_gives_way_to_what_a_model_lacks() -> None:
    """Else a model that is off by two steps leaves all of that to white noise, and any name gains thousands."""
    rng, step = np.random.default_rng(1), 0.5
    readings = Readings.at(np.arange(2000.0))
    shown = np.linspace(20.0, 60.0, 2000)
    right = step * np.round((shown + 0.2 * rng.standard_normal(2000)) / step) - shown
    wrong = step * np.round((shown + 1.0 * np.sin(np.arange(2000) / 30.0)) / step) - shown
    for residual, of_intervals in ((right, True), (wrong, False)):
        channel = ChannelNoise(estimate(residual, readings, step / 12.0**0.5), readings)
        assert (likelier_of_rounded(residual, step, channel).step > 0.0) == of_intervals


def test_an_effect_may_leave_something_slower() -> None:
    """Else a thermometer's lag that is plainly there is not named because the air about the board drifts for hours."""
    rng, time = np.random.default_rng(5), np.arange(4000) * 2.0
    drive = np.repeat(rng.uniform(0.0, 1.0, 40), 100)
    air, degC, lagging, shown = 25.0, 25.0, 25.0, []
    for k, u in enumerate(drive):
        air = 25.0 + 3.0 * np.sin(2.0 * np.pi * time[k] / 7000.0)
        shown.append(lagging)
        for _ in range(10):
            degC += 0.2 * (0.5 * u - 0.01 * (degC - air))
            lagging += 0.2 * (degC - lagging) / 15.0
    columns = {
        "time_s": time,
        "temperature_degC": np.array(shown) + 0.05 * rng.standard_normal(4000),
        "current_A": drive,
    }
    assert "sensor_lag" in [e.name for e in chosen(columns, "heater").fit.effects]


def test_a_record_may_begin_while_the_rig_runs() -> None:
    """Else a sink that is warm at the first row is made cold, and the room of that day with it."""
    assert resting_K(0.0) < 2.0
    assert resting_K(40.0) > 15.0


@pytest.mark.parametrize(("limit", "expected"), [(0.3, 0.3), (0.0, 2e-4), (math.inf, math.inf)])
def test_a_limit_is_the_strength_that_is_its_own(limit: float, expected: float) -> None:
    """Else "no lag above" is read off a size far from it, where the effect is another."""
    assert _allowed(lambda strength: limit, 1e-4, 100.0) == pytest.approx(expected, rel=0.06)


def test_what_jumps_has_a_limit_at_the_jump() -> None:
    """Else a dead band below the smallest command is excluded, which changes nothing."""
    allowed = _allowed(lambda strength: 0.0 if strength > 0.07 else math.inf, 1e-4, 3.0)
    assert 0.07 < allowed < 0.07 * 1.06
