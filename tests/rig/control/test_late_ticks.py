"""The law on ticks that come late, or not at all: it goes by the time that has passed, and not by a period."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from compensator.control.law import Law, LawSettings
from compensator.control.law_step import LawName
from compensator.control.pid import design_temperature
from compensator.control.reference_shaping import crossing_s, preview
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from rig.config.target import Target
from rig.control.decision import ReadAt
from rig.control.law_units import chain_observer
from rig.control.policies import Follow
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from tests.compensator.film_models import THIRTY_OPERATORS as FILM

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
PERIOD_S, AGE_S, ACTS_S, FIRST_DEGC, SECONDS = 0.1, 0.036, 0.017, 75.0, 60.0
NOISE_K, NOISE_DEC, STALLS_S = 0.01, 0.002, (12.0, 30.0, 43.0)
TIMES = np.linspace(0.0, SECONDS, 601)
WANTED = Target("resistance", TIMES, -3.3 + 0.8 * np.cos(2.0 * np.pi * TIMES / 100.0))
Late = Callable[[int], float]


def law_of(name: LawName, lag_s: float = 0.0) -> Law:
    effects = [switched(catalogue()["sensor_lag"], {"tau_s": lag_s})] if lag_s else []
    gains = design_temperature(PERIOD_S, PERIOD_S, 1.4).gains
    coming = preview(crossing_s(FILM, PLATE, 4.0, 10.0, 95.0), PERIOD_S)
    settings = LawSettings(name, PERIOD_S, 4.0, 10.0, 95.0, gains, *coming, fastest_K_per_s=5.0)
    return Law(settings, PLATE, FILM, chain_observer(effects, PLATE, FILM, PERIOD_S))


def followed(
    law: Law,
    late_s: Late,
    missed: Callable[[int], bool],
    held: int = 1,
    lost: range = range(0),
    acts_late_s: Late | None = None,
) -> Array:
    """(ticks, 5): time of reading, the film's error (dec), of the plate's estimate (K), noises believed (K, dec). The
    plant is the model; the ohmmeter gives each value `held` times, with its own time; lost: ticks without a
    thermometer; acts_late_s: by how much each command acts later than the law was told, None: not at all, and nobody
    says so."""
    rng, memory = np.random.default_rng(3), FILM.initial_memory(FIRST_DEGC, "cooled")
    policy = Follow(law, WANTED, memory)
    degC, shown, current, now, rows = FIRST_DEGC, FIRST_DEGC, 0.0, 0.0, []
    lag_s = law.observer.thermometer_lag_s if law.observer is not None else 0.0
    value = value_s = math.nan

    def until(time_s: float) -> None:
        nonlocal degC, shown, memory, now
        steps = max(1, math.ceil((time_s - now) / 0.005))
        step_s = (time_s - now) / steps
        for _ in range(steps if time_s > now else 0):
            degC = PLATE.step(degC, current, step_s)
            _, memory = FILM.step(degC, memory)
            shown = degC if lag_s == 0.0 else shown + (degC - shown) * (1.0 - math.exp(-step_s / lag_s))
        now = max(now, time_s)

    for k in range(round(SECONDS / PERIOD_S)):
        if missed(k):
            continue
        read_s = k * PERIOD_S + late_s(k)
        until(read_s)
        if k % held == 0 or math.isnan(value):
            value, value_s = FILM.output_at(memory) + NOISE_DEC * rng.standard_normal(), read_s
        degC_read = math.nan if k in lost else shown + NOISE_K * rng.standard_normal()
        read = ReadAt(late_s(k), read_s - value_s, ACTS_S, 0.0)
        decision = policy.decide(k * PERIOD_S, degC_read, value, read)
        until(read_s + ACTS_S + (acts_late_s(k) if acts_late_s is not None else 0.0))
        if acts_late_s is not None:
            policy.acted(now)
        state = policy.state
        assert state is not None
        off = FILM.output_at(memory) - float(policy.units.law(float(WANTED.at(now))))
        noises = math.sqrt(state.estimate.degC.variance), math.sqrt(state.estimate.output.variance)
        rows.append((now, off, state.temperature_degC - degC, *noises))
        current = decision.current_A if math.isfinite(decision.current_A) else current
    return np.array(rows)


def on_time(_: int) -> float:
    return 0.0


def none(_: int) -> bool:
    return False


def stall(k: int) -> bool:
    """1.5 s, three times."""
    return any(begin_s < k * PERIOD_S - 1e-9 <= begin_s + 1.5 for begin_s in STALLS_S)


@pytest.mark.parametrize("lag_s", [0.0, 1.5])
def test_after_a_stall_the_plate_is_where_it_is(lag_s: float) -> None:
    """A period for 1.5 s put the plate's estimate off by 0.46 K, and the plate was led back to where it should have
    been: 7 mdec over the ten seconds after it."""
    rows = followed(law_of("full", lag_s), on_time, stall)
    late = rows[:, 0] > 10.0
    assert np.max(np.abs(rows[late, 2])) < 0.02
    back = np.any([(rows[:, 0] > begin_s + 4.0) & (rows[:, 0] < begin_s + 13.0) for begin_s in STALLS_S], axis=0)
    assert np.sqrt(np.mean(rows[back, 1] ** 2)) < NOISE_DEC
    assert rows[-1, 3] < 3.0 * NOISE_K


@pytest.mark.parametrize(
    "late_s", [lambda k: 0.095 if k % 20 == 0 else 0.0, lambda k: 0.06 * math.modf(0.618 * k)[0]], ids=["one", "each"]
)
def test_late_ticks_cost_nothing(late_s: Late) -> None:
    """One in 20 by 95 ms was 6 times the error of none, each by up to 60 ms three times."""
    error = [
        np.sqrt(np.mean(followed(law_of("full"), late, none)[50:] ** 2, axis=0))[[1, 3]] for late in (on_time, late_s)
    ]
    assert error[1][0] < 1.5 * error[0][0]
    assert error[1][1] < 1.5 * error[0][1]


@pytest.mark.parametrize("lag_s", [0.0, 1.5])
def test_a_command_that_acts_late_is_counted_from_then(lag_s: float) -> None:
    """The first one waits for the output to be switched on, which took 0.2 s: the plate was told 0.5 K wrong."""
    arming = followed(law_of("full", lag_s), on_time, none, acts_late_s=lambda k: 0.2 if k == 0 else 0.0)
    at_once = followed(law_of("full", lag_s), on_time, none)
    assert np.max(np.abs(arming[:20, 2])) < np.max(np.abs(at_once[:20, 2])) + 2.0 * NOISE_K


def test_the_first_command_is_no_period_after_the_first_reading() -> None:
    """A plate 50 K above its room was told 0.1 K colder than it had just been read, and led there."""
    assert np.max(np.abs(followed(law_of("full"), on_time, none)[:20, 2])) < 3.0 * NOISE_K


def test_a_value_that_the_meter_gives_again_is_no_new_reading() -> None:
    """An ohmmeter that averages over ten ticks and tells when: its value, counted ten times, was 12 mdec of error."""
    rows = followed(law_of("full"), on_time, none, held=10)[100:]
    assert np.max(np.abs(rows[:, 1])) < 2.0 * NOISE_DEC


def test_without_a_thermometer_the_controller_s_own_current_is_not_made_up() -> None:
    """The plate is then where it was read last, as far as anybody knows: nothing was ever sent to its output."""
    law = law_of("instrument_pid")
    policy = Follow(law, WANTED, state=law.start(60.0, None)._replace(current_A=2.0))
    policy.decide(0.0, math.nan, math.nan)
    assert policy.state is not None
    assert policy.state.temperature_degC == 60.0
