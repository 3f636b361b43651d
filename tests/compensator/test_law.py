"""The compiled control law against the same law put together from its public parts, and its behaviour in a loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compensator.film import Envelope, FilmModel, Memoryless
from compensator.inverse import Inverse
from compensator.law import NAMES, Law, LawName, LawSettings, LawState
from compensator.pid import PidGains, PidState, pid_integrate, pid_output
from compensator.plate import PlateModel
from compensator.reference import next_reference, next_temperature

FILM = FilmModel(
    np.arange(1, 31) / 30.0,
    np.full(30, 0.05),
    Envelope("tanh", 0.2, -11.6),
    Envelope("tanh", 0.2, -11.2),
    Memoryless("tanh", 0.4, 0.03, -1.6, -3.26),
)
PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)


def law_of(name: LawName) -> Law:
    gains = PidGains(8.0, 3.0, 0.5, 0.2, 2.0) if name == "pid" else PidGains(1.2, 0.3, 0.05, 0.2, 1.0)
    return Law(LawSettings(name, 0.1, 4.0, 10.0, 95.0, gains), PLATE, None if name == "temperature" else FILM)


def plain_step(
    law: Law, state: LawState, reading: float, output: float, target_now: float, targets: np.ndarray
) -> tuple[float, float, LawState]:
    """One period from the public parts, as the law's docstring says: (current, setpoint, state)."""
    s, film, pid = law.settings, law.film, state.pid
    here = PLATE.step(state.temperature_degC, state.current_A, s.period_s)
    if s.name == "instrument_pid" and not math.isnan(reading):
        here = reading
    elif s.name != "feedforward" and not math.isnan(reading):
        here += s.observer_gain * (reading - here)
    memory, disturbance = state.memory, state.disturbance
    if film is not None:
        expected, memory = film.step(here, memory)
        if s.name in ("full", "instrument_pid") and math.isfinite(output):
            disturbance += min(s.period_s / s.disturbance_time_s, 1.0) * (output - expected - disturbance)
    if s.name == "pid":
        if not math.isfinite(output):
            return state.current_A, math.nan, LawState(here, state.reference_degC, memory, 0.0, pid, state.current_A)
        wanted, pid = pid_output(s.gains, pid, target_now, output, s.period_s)
        low, high = PLATE.current_range_A(here, s.current_limit_A)
        current = min(max(wanted, low), high)
        pid = pid_integrate(s.gains, pid, target_now, output, current - wanted, s.period_s)
        return current, math.nan, LawState(here, state.reference_degC, memory, 0.0, pid, current)
    cooling, heating = (s.rate_share * rate for rate in PLATE.rate_range_K_per_s(here, s.current_limit_A))
    cooling, heating = min(cooling, -1e-6), max(heating, 1e-6)
    if film is None:
        following = next_temperature(targets, s.preview_spacing_s, s.period_s, state.reference_degC, cooling, heating)
    else:
        limits, table = Inverse(film, s.low_degC, s.high_degC).settings()
        band = s.band if s.name != "feedforward" else 0.0
        rates = s.preview_spacing_s, s.period_s, state.reference_degC, cooling, heating
        plays = memory.plays.copy()
        _, following = next_reference(
            targets - disturbance, band, memory.input_degC, plays, film.packed, limits, table, *rates
        )
    following = min(max(following, s.low_degC), s.high_degC)
    rate = (following - state.reference_degC) / s.period_s
    if s.name in ("full", "temperature"):
        correction, pid = pid_output(s.gains, pid, state.reference_degC, here, s.period_s)
        rate += correction
    current = PLATE.current_for_rate_A(here, rate, s.current_limit_A)
    if s.name in ("full", "temperature"):
        shortfall = PLATE.rate_K_per_s(here, current) - rate
        shortfall = 0.0 if abs(shortfall) < 1e-12 else shortfall
        pid = pid_integrate(s.gains, pid, state.reference_degC, here, shortfall, s.period_s)
    return current, following, LawState(here, following, memory, disturbance, pid, current)


@pytest.mark.parametrize("name", NAMES)
def test_the_compiled_step_is_the_law_s_parts(name: LawName) -> None:
    law, rng, plate_degC, current = law_of(name), np.random.default_rng(5), 50.0, 0.0
    film_memory = FILM.initial_memory(50.0)
    state = law.start(50.0, film_memory if law.film is not None else None)
    ahead, rows = law.preview_times_s(), []
    for k in range(400):
        t = 0.1 * k
        plate_degC = PLATE.step(plate_degC, current, 0.1) + 0.002 * math.sin(t)
        output, film_memory = FILM.step(plate_degC, film_memory)
        reading = math.nan if k % 37 == 5 else plate_degC + 0.01 * rng.normal()
        measured = math.nan if k % 53 == 7 else output + 0.002 * rng.normal() + 0.02 * math.sin(0.1 * t)
        now, coming = wanted(name, t), np.asarray(wanted(name, t + ahead))
        expected_current, setpoint, expected = plain_step(law, state, reading, measured, float(now), coming)
        command, state = law.step(state, reading, measured, float(now), coming)
        assert command.current_A == pytest.approx(expected_current, abs=1e-12)
        assert command.setpoint_degC == pytest.approx(setpoint, abs=1e-12, nan_ok=True)
        for mine, other in ((state.disturbance, expected.disturbance), (state.pid.integral, expected.pid.integral)):
            assert mine == pytest.approx(other, abs=1e-12)
        assert state.temperature_degC == pytest.approx(expected.temperature_degC, abs=1e-12)
        assert np.array_equal(state.memory.plays, expected.memory.plays)
        current = command.current_A
        rows.append(output - float(now))
    if name == "full":
        assert np.std(rows[100:]) < 0.2  # the target's own standard deviation is 0.47


def wanted(name: str, t: object) -> np.ndarray:
    time = np.asarray(t, dtype=np.float64)
    if name == "temperature":
        return 60.0 + 8.0 * np.sin(0.3 * time)
    return -3.0 + 0.6 * np.sin(0.25 * time) + 0.2 * np.sign(np.sin(0.1 * time))


def test_the_state_is_a_value() -> None:
    law = law_of("full")
    state = law.start(50.0, None)
    targets = np.full(8, -2.9)
    targets.setflags(write=False)
    first = law.step(state, 50.1, -3.4, -2.9, targets)
    again = law.step(state, 50.1, -3.4, -2.9, targets)
    assert first[0] == again[0]
    assert np.array_equal(first[1].memory.plays, again[1].memory.plays)
    with pytest.raises(ValueError, match="read-only"):
        first[1].memory.plays[0] = 0.0


def test_an_output_that_cannot_be_reached_is_told() -> None:
    law = law_of("full")
    command, _ = law.step(law.start(50.0, None), 50.0, math.nan, -20.0, np.full(8, -20.0))
    assert not command.reachable
    assert law.start(50.0, None).pid == PidState()


def test_a_law_of_the_resistance_needs_a_film() -> None:
    with pytest.raises(ValueError, match="film model"):
        Law(LawSettings("full", 0.1, 4.0, 10.0, 95.0, PidGains(1.0, 0.1)), PLATE, None)
