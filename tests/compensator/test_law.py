"""The compiled control law against the same law put together from its public parts, and its behaviour in a loop."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from compensator.control.estimator import (
    DRIVE_DOUBT,
    ERROR_MEMORY,
    ERROR_SIZES,
    HEAT_MEMORY_S,
    LAGS_S,
    LARGEST_SQUARE,
    STANDS_S,
    UNSTEADY_K_PER_S2,
)
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import NAMES, Inputs, LawName, LawState
from compensator.control.pid import PidGains, pi_integrated, pi_output
from compensator.control.reference_shaping import FilmNow, Reach, Reference, Turn, next_reference, next_temperature
from compensator.hysteresis.film import Memory
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import THIRTY_OPERATORS as FILM

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
AGE_S, ACTS_S = 0.04, 0.02


def law_of(name: LawName) -> Law:
    gains = PidGains(8.0, 3.0, 2.0) if name == "pid" else PidGains(1.2, 0.3, 1.0)
    return Law(LawSettings(name, 0.1, 4.0, 10.0, 95.0, gains), PLATE, None if name == "temperature" else FILM)


class PlainEstimate:
    """Both banks of filters, written once more: noise by second differences, Kalman by matrices."""

    def __init__(self, output_range: float, degC: float) -> None:
        self.noise = {"degC": [1e-4, 0], "output": [4e-6, 0]}
        self.lately: dict[str, list[tuple[int, float]]] = {"degC": [], "output": []}
        self.tick = 0
        self.drift, self.drive, self.range, self.sizes2 = 0.0, 0.0, output_range, (ERROR_SIZES * output_range) ** 2
        self.values, self.doubts, self.chances = (
            np.zeros(ERROR_SIZES.size),
            self.sizes2.copy(),
            np.ones(ERROR_SIZES.size),
        )
        self.shown, doubt = degC, np.diag([1e-4, 1e-4, 4e-4, DRIVE_DOUBT**2])
        doubt[0, 1] = doubt[1, 0] = 1e-4
        self.heats = {(lag, w): (np.zeros(4), doubt) for lag in LAGS_S for w in UNSTEADY_K_PER_S2}
        self.lags, self.likely = dict.fromkeys(LAGS_S, 1.0), dict.fromkeys(self.heats, 1.0)  # of a size, given its lag
        self.moved, self.toward = 0.0, 0.0

    def learn(self, which: str, value: float) -> None:
        """By the line through the two readings before, however many ticks they are away."""
        past, noise = self.lately[which], self.noise[which]
        if len(past) == 2:
            (first, one), (second, two) = past
            slope = (two - one) / (second - first)
            ratio = (self.tick - second) / (second - first)
            off = value - (two + slope * (self.tick - second))
            noise[1] = min(noise[1] + 1, 300)
            noise[0] += (off**2 / (1.0 + (1.0 + ratio) ** 2 + ratio**2) - noise[0]) / (noise[1] + 20)
        self.lately[which] = [*past, (self.tick, value)][-2:]

    def temperature(self, before: float, predicted: float, reading: float, period: float, driven: float) -> float:
        """The plate; before, predicted: a period before, and now. Filters of thermometer, plate, heating rate and the
        share by which the drive gives more than `driven`."""
        self.learn("degC", reading)
        noise, moved = self.noise["degC"][0] + 1e-12, predicted - before
        for (lag, w), (over, covariance) in self.heats.items():
            a = 1.0 - math.exp(-period / lag) if lag else 1.0
            late = period - lag * a
            forward = np.eye(4)
            forward[0] = 1.0 - a, a, late, late * driven
            forward[1, 2:] = period, period * driven
            heat = np.array([0.5 * period**2 - lag * late, 0.5 * period**2, period, 0.0])
            p = forward @ covariance @ forward.T + w**2 * np.outer(heat, heat)
            at, along = np.array([self.shown, before, 0.0, 0.0]), np.array([late / period, 1.0, 0.0, 0.0])
            there = forward @ (over + at) + along * moved
            now = there - np.array([predicted, predicted, 0.0, 0.0])
            rate = (there[0] - over[0] - self.shown) / period
            whole, off = p[0, 0] + noise, reading - (there[0] - rate * ACTS_S)
            gain = p[:, 0] / whole
            self.heats[lag, w] = now + gain * off, p - np.outer(gain, p[0])
            self.likely[lag, w] *= math.exp(-0.5 * min(off**2 / whole, LARGEST_SQUARE)) / math.sqrt(whole)
        self.forget(period)
        told = sum(self.weights[each] * over for each, (over, _) in self.heats.items())
        self.heats = {each: (over - told, covariance) for each, (over, covariance) in self.heats.items()}
        self.drift, self.shown = self.drift + float(told[2]), float(predicted + told[0])
        self.drive += float(told[3])
        return float(predicted + told[1])

    def forget(self, period: float) -> None:
        """The weights, and what is kept of them."""
        kept = math.exp(-period / HEAT_MEMORY_S)
        for lag in LAGS_S:
            inside = sum(self.likely[lag, w] for w in UNSTEADY_K_PER_S2)
            self.lags[lag] *= inside
            for w in UNSTEADY_K_PER_S2:
                self.likely[lag, w] /= inside
        whole = sum(self.lags.values())
        self.lags = {lag: max(each / whole, 1e-300) for lag, each in self.lags.items()}
        self.weights = {each: self.lags[each[0]] * chance for each, chance in self.likely.items()}
        faded = {each: chance**kept for each, chance in self.likely.items()}
        whole_of = {lag: sum(faded[lag, w] for w in UNSTEADY_K_PER_S2) for lag in LAGS_S}
        self.likely = {each: chance / whole_of[each[0]] for each, chance in faded.items()}

    @property
    def doubt(self) -> float:
        share = self.chances / np.sum(self.chances)
        return float(np.sum(share * (self.doubts + self.values**2)) - np.sum(share * self.values) ** 2)

    def disturbance(self, off: float, output: float, period: float) -> float:
        gone = abs(self.moved) / self.range
        self.doubts += self.sizes2 * (gone + period / STANDS_S)
        self.chances **= math.exp(-gone / ERROR_MEMORY)
        if math.isfinite(off):
            self.learn("output", output)
            whole = self.doubts + self.noise["output"][0] + 1e-12
            likely = np.exp(-0.5 * np.minimum((off - self.values) ** 2 / whole, LARGEST_SQUARE)) / np.sqrt(whole)
            self.chances *= likely
            self.chances /= np.max(self.chances)
            self.values += self.doubts / whole * (off - self.values)
            self.doubts *= 1.0 - self.doubts / whole
        return float(np.sum(self.chances * self.values) / np.sum(self.chances))


def plain_step(
    law: Law, state: LawState, known: PlainEstimate, reading: float, output: float, target_now: float, targets: Array
) -> tuple[float, float, LawState, float]:
    """One period from the public parts, as the law's docstring says: (current, setpoint, state, disturbance)."""
    s, film, integral = law.settings, law.film, state.integral
    known.tick += 1
    before, seebeck = state.temperature_degC, PLATE.seebeck_over_capacity_per_A_s
    plate = replace(PLATE, seebeck_over_capacity_per_A_s=seebeck * (1.0 + known.drive))
    here = plate.step(before, state.current_A, s.period_s) + known.drift * s.period_s
    if s.name == "instrument_pid":
        here = state.temperature_degC if math.isnan(reading) else reading
    elif s.name != "feedforward" and not math.isnan(reading):
        driven = seebeck * state.current_A * (before + 273.15)
        here = known.temperature(before, here, reading, s.period_s, driven)
    else:
        known.shown = here
    memory, disturbance = state.memory, state.disturbance
    if film is not None:
        expected, memory = film.step(here, memory)
        if s.name in ("full", "instrument_pid"):
            off = output + known.moved / s.period_s * (AGE_S + ACTS_S) - expected
            disturbance = known.disturbance(off, output, s.period_s)
    before = state.reference_degC
    if s.name == "pid":
        current = state.current_A
        if math.isfinite(output):
            wanted = pi_output(s.gains, integral, target_now, output)
            low, high = plate.current_range_A(here, s.current_limit_A)
            current = min(max(wanted, low), high)
            integral = pi_integrated(s.gains, integral, target_now, output, current - wanted, s.period_s)
        return current, math.nan, after(here, before, memory, integral, current), 0.0
    cooling, heating = (s.rate_share * rate for rate in plate.rate_range_K_per_s(here, s.current_limit_A))
    reach = Reach(s.preview_spacing_s, s.period_s, min(cooling, -1e-6), max(heating, 1e-6), 0.0)
    if film is None:
        following = next_temperature(targets, Reference(before, before), reach).film_degC
    else:
        settings = Inverse(film, s.low_degC, s.high_degC).settings()
        band = s.reversal * math.sqrt(known.doubt) if s.name != "feedforward" else 0.0
        turn = Turn(band, known.toward, before)
        now = FilmNow(memory.input_degC, memory.plays.copy(), film.packed, settings)
        plan = next_reference(targets - disturbance, turn, now, Reference(before, before), reach)
        following, known.moved = plan.reference.film_degC, plan.move
        if following != before and known.moved != 0.0:
            known.toward = math.copysign(1.0, known.moved)
    following = min(max(following, s.low_degC), s.high_degC)
    rate = (following - (before if s.name in ("full", "temperature") else here)) / s.period_s
    if s.name in ("full", "temperature"):
        rate += pi_output(s.gains, integral, before, here)
    current = plate.current_for_rate_A(here, rate, s.current_limit_A)
    if s.name in ("full", "temperature"):
        shortfall = plate.rate_K_per_s(here, current) - rate
        shortfall = 0.0 if abs(shortfall) < 1e-12 else shortfall
        integral = pi_integrated(s.gains, integral, before, here, shortfall, s.period_s)
    return current, following, after(here, following, memory, integral, current), disturbance


def after(here: float, reference: float, memory: Memory, integral: float, current: float) -> LawState:
    """A state with what the plain step knows."""
    led = Reference(reference, reference)
    return LawState(here, here, led, led, memory.input_degC, memory.plays, integral, current)


@pytest.mark.parametrize("name", NAMES)
def test_the_compiled_step_is_the_law_s_parts(name: LawName) -> None:
    law, rng, plate_degC, current = law_of(name), np.random.default_rng(5), 50.0, 0.0
    film_memory = FILM.initial_memory(50.0)
    state = law.start(50.0, film_memory if law.film is not None else None)
    ahead, rows, known = law.preview_times_s(), [], PlainEstimate(law.rule.output_range, 50.0)
    for k in range(400):
        t = 0.1 * k
        plate_degC = PLATE.step(plate_degC, current, 0.1) + 0.002 * math.sin(t)
        output, film_memory = FILM.step(plate_degC, film_memory)
        reading = math.nan if k % 37 == 5 else plate_degC + 0.01 * rng.normal()
        measured = math.nan if k % 53 == 7 else output + 0.002 * rng.normal() + 0.02 * math.sin(0.1 * t)
        now, coming = wanted(name, t), np.asarray(wanted(name, t + ahead))
        asked = reading, measured, float(now), coming
        expected_current, setpoint, expected, disturbance = plain_step(law, state, known, *asked)
        command, state = law.step(state, Inputs(*asked, AGE_S, ACTS_S))
        assert command.current_A == pytest.approx(expected_current, abs=1e-12)
        assert command.setpoint_degC == pytest.approx(setpoint, abs=1e-12, nan_ok=True)
        for mine, other in ((state.disturbance, disturbance), (state.integral, expected.integral)):
            assert mine == pytest.approx(other, abs=1e-12)
        assert state.temperature_degC == pytest.approx(expected.temperature_degC, abs=1e-12)
        assert state.memory.plays == pytest.approx(expected.memory.plays, abs=1e-12)  # matrices: by the machine's BLAS
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
    inputs = Inputs(50.1, -3.4, -2.9, targets)
    first, again = law.step(state, inputs), law.step(state, inputs)
    assert first[0] == again[0]
    for one, other in zip(first[1], again[1], strict=True):
        assert np.array_equal(np.ravel(flat(one)), np.ravel(flat(other)), equal_nan=True)
    for plays in (first[1].plays, first[1].memory.plays, state.plays):
        with pytest.raises(ValueError, match="read-only"):
            plays[0] = 0.0
    with pytest.raises(AttributeError):
        first[1].current_A = 1.0  # type: ignore[misc]


def flat(part: object) -> list[float]:
    """All numbers of a part of a state, in order."""
    if isinstance(part, tuple):
        return [number for each in part for number in flat(each)]
    return [] if part is None else list(np.ravel(np.asarray(part, dtype=np.float64)))


def test_an_output_that_cannot_be_reached_is_told() -> None:
    law = law_of("full")
    command, _ = law.step(law.start(50.0, None), Inputs(50.0, math.nan, -20.0, np.full(8, -20.0)))
    assert not command.reachable
    assert law.start(50.0, None).integral == 0.0


def test_a_law_of_the_resistance_needs_a_film() -> None:
    with pytest.raises(ValueError, match="film model"):
        Law(LawSettings("full", 0.1, 4.0, 10.0, 95.0, PidGains(1.0, 0.1)), PLATE, None)
