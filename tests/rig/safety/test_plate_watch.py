"""The plate is watched, a known one or not: what no plate can do trips; real plates, wrong models and slow thermometers
do not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compensator.thermal.plate import RESISTANCE_SLOPE_PRIOR_PER_K, SEEBECK_SLOPE_PRIOR_PER_K, PlateModel
from rig.core.outcome import Tripped
from rig.safety.plate_watch import (
    OF_A_MODEL,
    OF_A_PULSE,
    OF_PULSES,
    Doubt,
    KnownPlate,
    PlateWatch,
    RunawayWatch,
    distinct,
    first_plate,
    watchable_rate_K_per_s,
)
from sim.inference.plate.fit import identify_plate

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
CLEAN = ("8010", "8020", "8055", "500", "8051", "8052", "80510")


def trip_on(look: Callable[[float, float, float], object], rows: np.ndarray) -> Tripped | None:
    """What a measured record (time, temperature, duty) trips on, in the eyes of a watch."""
    sent = 0.0
    for time_s, temperature_degC, duty in rows:
        try:
            look(time_s, temperature_degC, sent)
        except Tripped as trip:
            return trip
        sent = duty
    return None


@pytest.mark.parametrize("model", ["8010", "8020", "8055"])
def test_measured_records(measured: Path, model: str) -> None:
    """With the plate of one run the others pass, and a heat sink that saturates is seen."""
    fit = identify_plate(*record(measured, model).T, lag=True)

    def replayed(name: str, doubt: Doubt) -> Tripped | None:
        watch = PlateWatch(1.0, 1000.0, 20.0)
        watch.know(KnownPlate(fit.model, fit.lag_s, doubt=doubt))
        return trip_on(watch.look, record(measured, name))

    for doubt in (OF_A_MODEL, OF_PULSES):
        for name in CLEAN:
            assert replayed(name, doubt) is None, name
        trip = replayed("runaway", doubt)
        assert trip is not None
        assert trip.time_s < 420.0  # from 350 s on the duty is -1 and the temperature rises


def record(folder: Path, name: str) -> np.ndarray:
    return np.genfromtxt(folder / f"peltier_{name}.csv", delimiter=",", skip_header=1)


Truth = Callable[[float], PlateModel]
Course = Callable[[float, float], float]  # time, degC -> what is sent, or what is read


def course(
    sent: Course,
    read: Course = lambda time_s, degC: degC,
    true: Truth = lambda time_s: PLATE,
    known: KnownPlate | None = None,
    first_degC: float = 40.0,
    length_s: float = 150.0,
    step_K: float = 0.0,
    lag_s: float = 0.0,
    wired: Course = lambda time_s, current: current,
) -> tuple[Tripped | None, float]:
    """What a run trips on, and the plate's true temperature then. sent: from the reading."""
    watch, chance = PlateWatch(4.0, 95.0, 20.0), np.random.default_rng(1)
    watch.know(known or KnownPlate(PLATE))
    plate_degC = shown = first_degC
    current = 0.0
    for k in range(int(length_s * 5)):
        time_s = 0.2 * k
        reading = read(time_s, shown) + 0.005 * float(chance.standard_normal())
        reading = round(reading / step_K) * step_K if step_K else reading
        try:
            watch.look(time_s, reading, current)
        except Tripped as trip:
            return trip, plate_degC
        current = min(max(sent(time_s, reading), -4.0), 4.0)
        plate_degC = true(time_s).step(plate_degC, wired(time_s, current), 0.2)
        shown = plate_degC if not lag_s else shown + (plate_degC - shown) * -math.expm1(-0.2 / lag_s)
    return None, plate_degC


def held_at(degC: float) -> Course:
    """A controller that holds what it reads."""
    return lambda time_s, reading: PLATE.current_for_rate_A(reading, 0.5 * (degC - reading), 4.0)


WAVES: dict[str, Course] = {
    "heats": lambda t, degC: 1.2,
    "cools": lambda t, degC: -1.2,
    "both": lambda t, degC: 2.0 * math.sin(t / 8.0),
}


@pytest.mark.parametrize("step_K", [0.0, 0.25])
@pytest.mark.parametrize("wave", sorted(WAVES))
def test_a_model_that_is_wrong_passes(wave: str, step_K: float) -> None:
    """By as much as a pulse leaves open: gain 15 %, Joule heat by half, loss by 40 %."""
    true = PlateModel(1.4e-3, 0.09, 0.025, 25.0)
    known = KnownPlate(PLATE, doubt=OF_A_PULSE)
    assert course(WAVES[wave], true=lambda t: true, known=known, step_K=step_K)[0] is None


@pytest.mark.parametrize("by", ["its slopes", "usual slopes", "a pulse", "a record"])
def test_a_module_that_changes_with_temperature_passes(by: str) -> None:
    """Full current both ways from 12 to 92 degC. The watch knows the module's slopes; or those that modules have, which
    are off by what they scatter; or none, as long as the plate was not identified yet or by a program of before."""
    true = replace(PLATE, seebeck_slope_per_K=0.002, resistance_slope_per_K=0.004)
    time, current = 0.1 * np.arange(6000), np.zeros(6000)
    current[20:70] = 1.0
    if by == "a record":
        current = np.where(time % 50.0 < 25.0, 1.0, -0.3) * np.where(time % 200.0 < 100.0, 3.0, 1.0)
    degC = true.simulate(25.0, time, current) + 0.005 * np.random.default_rng(4).standard_normal(time.size)
    known: KnownPlate | None = KnownPlate(true)
    if by == "usual slopes":
        usual = SEEBECK_SLOPE_PRIOR_PER_K[0], RESISTANCE_SLOPE_PRIOR_PER_K[0]
        known = KnownPlate(replace(true, seebeck_slope_per_K=usual[0], resistance_slope_per_K=usual[1]))
    elif by == "a pulse":
        known = first_plate(time[:200], degC[:200], current[:200], 4.0)
    elif by == "a record":
        known = KnownPlate(identify_plate(time, degC, current).model)

    def full(t: float, degC: float) -> float:
        return math.copysign(4.0, math.sin(t / 10.0)) if 12.0 < degC < 92.0 else 0.0

    assert known is not None
    for wave in (full, held_at(90.0), *WAVES.values()):
        for first_degC in (15.0, 60.0, 85.0):
            assert course(wave, true=lambda t: true, known=known, first_degC=first_degC)[0] is None


@pytest.mark.parametrize("lag_s", [0.6, 5.0, 30.0])
def test_a_thermometer_that_is_known_to_lag_passes(lag_s: float) -> None:
    known = KnownPlate(PLATE, 1.2 * lag_s)
    assert course(WAVES["both"], known=known, lag_s=lag_s)[0] is None
    assert watchable_rate_K_per_s(known) * 1.2 * lag_s <= 10.0 + 1e-9


@pytest.mark.parametrize("doubt", [OF_A_MODEL, OF_A_PULSE])
@pytest.mark.parametrize(
    "read",
    [
        lambda t, degC: degC if t < 60.0 else 25.0 + 35.0 * math.exp(-(t - 60.0) / 5.0),
        lambda t, degC: degC if t < 60.0 else 25.0 + max(1.0 - (t - 60.0) / 20.0, 0.0) * (degC - 25.0),
        lambda t, degC: degC - 1.5 * max(t - 60.0, 0.0),
    ],
    ids=["falls", "falls within 20 s", "drifts"],
)
def test_a_sensor_that_is_lost_in_a_hold(read: Course, doubt: Doubt) -> None:
    trip, plate_degC = course(held_at(60.0), read, known=KnownPlate(PLATE, doubt=doubt), first_degC=60.0)
    assert trip is not None
    assert trip.cause == "unseen_heat"
    assert trip.time_s >= 60.0
    assert plate_degC < 75.0


@pytest.mark.parametrize("doubt", [OF_A_MODEL, OF_A_PULSE])
def test_a_sensor_that_sticks_while_the_plate_is_heated(doubt: Doubt) -> None:
    ramp: Course = lambda t, degC: PLATE.current_for_rate_A(degC, 1.5 + 0.5 * (30.0 + 1.5 * t - degC), 4.0)  # noqa: E731
    trip, plate_degC = course(
        ramp, lambda t, degC: min(degC, 50.0), known=KnownPlate(PLATE, doubt=doubt), first_degC=30.0
    )
    assert trip is not None
    assert plate_degC < 65.0


def test_a_plate_that_is_a_fifth_off_and_a_thermometer_that_shows_four_fifths_look_alike() -> None:
    """So either ends the run, and only the first is a matter of another calibration."""
    ramp: Course = lambda t, degC: PLATE.current_for_rate_A(degC, 1.2 + 0.5 * (30.0 + 1.2 * t - degC), 4.0)  # noqa: E731
    weaker = PlateModel(0.8 * 1.6e-3, 0.06, 0.018, 25.0)
    of_another, _ = course(ramp, true=lambda t: weaker, first_degC=30.0)
    half_off, plate_degC = course(ramp, lambda t, degC: 25.0 + 0.8 * (degC - 25.0), first_degC=30.0)
    for trip in (of_another, half_off):
        assert trip is not None
        assert trip.cause == "unseen_heat"
        assert "the model is of another plate: calibrate" in str(trip)
        assert not str(trip).endswith(".")  # what became of the output is told behind it
    assert plate_degC < 75.0


@pytest.mark.parametrize(
    ("more", "less", "shown"),
    [(2.631, 2.584, ("2.63", "2.58")), (4.0, 2.6, ("4.0", "2.6")), (2.6000001, 2.6, ("2.600", "2.600"))],
)
def test_what_is_more_is_shown_as_more(more: float, less: float, shown: tuple[str, str]) -> None:
    assert distinct(more, less) == shown


@pytest.mark.parametrize("current_A", [3.0, -3.0])
def test_a_polarity_that_turns(current_A: float) -> None:
    trip, _ = course(lambda t, degC: current_A, wired=lambda t, current: -current)
    assert trip is not None
    assert trip.time_s < 5.0


def test_a_heat_sink_that_saturates() -> None:
    """Cooling at full current, and it gets warmer: the sink warms up without end."""
    warm = [PlateModel(1.6e-3, 0.06, 0.1, 25.0 + 1.5 * k) for k in range(200)]
    assert course(lambda t, degC: -4.0, true=lambda t: warm[int(t)], first_degC=20.0)[0] is not None


def test_a_plate_that_may_be_above_its_limit_though_the_thermometer_is_not() -> None:
    trip, plate_degC = course(
        lambda t, degC: 2.5, known=KnownPlate(PLATE, 10.0), lag_s=10.0, first_degC=60.0, length_s=90.0
    )
    assert trip is not None
    assert trip.cause == "hidden_heat"
    assert plate_degC < 99.0


def test_more_cooling_current_than_cools() -> None:
    watch = PlateWatch(16.0, 95.0, 20.0)
    watch.know(KnownPlate(PLATE))
    watch.check_cooling(0.0, 20.0, -7.5)
    with pytest.raises(Tripped, match="more current cools less") as trip:
        watch.check_cooling(0.0, 20.0, -9.0)
    assert trip.value.cause == "cooling_limit"


@pytest.mark.parametrize(("lag_s", "delay_s"), [(0.0, 0.0), (0.0, 2.0), (3.0, 0.0), (20.0, 0.0)])
def test_one_pulse_tells_gain_lag_and_delay(lag_s: float, delay_s: float) -> None:
    """Rest, 1 A for 5 s, and 0 A: the heating rate per ampere to 10 %, and how late heat shows."""
    chance = np.random.default_rng(3)
    time = 0.25 * np.arange(int(4 * (20.0 + 3.0 * lag_s)))
    current = np.where((time >= 2.0) & (time < 7.0), 1.0, 0.0)
    plate = shown = 25.0
    readings = []
    for t in time:
        readings.append(shown + 0.01 * chance.standard_normal())
        plate = PLATE.step(plate, 1.0 if 2.0 <= t - delay_s < 7.0 else 0.0, 0.25)
        shown = plate if not lag_s else shown + (plate - shown) * -math.expm1(-0.25 / lag_s)
    known = first_plate(time, np.array(readings), current, 4.0)
    assert known is not None
    assert known.plate.seebeck_over_capacity_per_A_s == pytest.approx(1.6e-3, rel=0.1 if lag_s < 10.0 else 0.6)
    assert known.lag_s + known.delay_s == pytest.approx(lag_s + delay_s, abs=0.35 + 0.5 * (lag_s > 10.0) * lag_s)
    assert known.behind_s >= lag_s + delay_s - 0.35 - 0.5 * (lag_s > 10.0) * lag_s


def test_a_pulse_that_moves_nothing_tells_nothing() -> None:
    time = 0.25 * np.arange(80)
    current = np.where((time >= 2.0) & (time < 7.0), 1.0, 0.0)
    falling = 25.0 - 0.3 * np.cumsum(current) * 0.25
    assert first_plate(time, falling, current, 4.0) is None
    assert first_plate(time, falling, np.zeros(80), 4.0) is None


def test_a_pulse_in_coarse_steps_is_a_plate_and_no_drift() -> None:
    """Of 0.5 K: a drift and a little more tell it as well as a plate that is moved by the current."""
    time = np.arange(60) * 0.25
    current = np.where((time >= 1.5) & (time < 6.75), 1.0, 0.0)
    moved = 0.25 * np.clip(time - 1.75, 0.0, 5.25)
    for begin_degC in np.linspace(24.0, 24.5, 7):
        known = first_plate(time, np.round((begin_degC + moved) / 0.5) * 0.5, current, 4.0)
        assert known is not None
        assert 0.25 / 2.0 < known.plate.rate_K_per_s(known.plate.ambient_degC, 1.0) < 0.25 * 2.0


def test_measured_records_of_an_unknown_plate(measured: Path) -> None:
    """Clean runs pass; a saturated heat sink is seen."""

    def replayed(name: str) -> Tripped | None:
        watch = RunawayWatch(1.0, 20.0)
        return trip_on(lambda *row: watch.look(*row, math.nan), record(measured, name))

    for name in CLEAN[:4]:
        assert replayed(name) is None, name
    trip = replayed("runaway")
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
