"""The generator of the blind cases: its physics, its numerics, its promises."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.sim.diagnosis.cases import Case, case, write_record
from tests.sim.diagnosis.score import named_as_set, score, wilson
from tests.sim.diagnosis.truth.combine import allowed, recorded_current
from tests.sim.diagnosis.truth.disturb import DISTURBANCES, disturbed
from tests.sim.diagnosis.truth.draw import Bench, draw_bench, draw_film
from tests.sim.diagnosis.truth.hysteresis import PREISACH
from tests.sim.diagnosis.truth.oracle import Oracle
from tests.sim.diagnosis.truth.rig import Clean, Effects, Rig, Schedule, simulate
from tests.sim.diagnosis.truth.sizes import weaker

Array = NDArray[np.float64]
FILMS = ("of_class", "preisach", "forc", "moving", "medium", "mixed")


@pytest.fixture(scope="module")
def bench() -> Bench:
    """A short bench of the class."""
    return draw_bench(np.random.default_rng(3), rows=1600)


def opened(bench: Bench, effects: Effects | None = None, **more: object) -> Clean:
    """The record without noise, at the currents of the plain rig's loop."""
    current = simulate(bench.rig, bench.schedule).current
    rig: Rig = replace(bench.rig.having(effects or {}), **more)  # type: ignore[arg-type]
    return simulate(rig, replace(bench.schedule, setpoint=None, current=current))


def furthest(one: Clean, two: Clean, bench: Bench) -> float:
    """The largest difference over the noise, in either channel."""
    heat = np.max(np.abs(one.temperature - two.temperature)) / bench.rig.noise_K
    return float(max(heat, np.max(np.abs(one.log_ohm - two.log_ohm)) / bench.rig.noise_dec))


def test_plate_keeps_its_heat_balance(bench: Bench) -> None:
    """Sink, radiation and drift against another integrator, the terms written out again."""
    p, ratio, share, loss, drift = bench.rig.plate, 6.0, 0.2, 5e-12, 3.0 / 3600.0
    effects = {
        "heat_sink_warmup": {"sink_capacity_ratio": ratio, "sink_conductance_ratio_per_s": share},
        "radiative_loss": {"loss_per_K3_s": loss},
        "ambient_drift": {"drift_K_per_h": 3.0},
    }
    current = 1.3

    def balance(t: float, x: Array) -> list[float]:
        room, joule = p.ambient_degC + drift * t, 0.5 * p.b * current**2
        far = p.g * (x[0] - x[1])
        glow = loss * ((x[0] + 273.15) ** 4 - (room + 273.15) ** 4)
        plate = p.a * current * (x[0] + 273.15) + joule - far - glow
        return [plate, (-p.a * current * (x[1] + 273.15) + joule + far - share * (x[1] - room)) / ratio]

    time = np.arange(200) * 0.5
    schedule = Schedule(time, np.full(200, 1e-5), current=np.full(200, current))
    got = simulate(bench.rig.having(effects), schedule)
    start = [p.start_degC, p.ambient_degC]
    want = solve_ivp(balance, (0.0, time[-1]), start, "DOP853", time, rtol=1e-11, atol=1e-11).y[0]
    np.testing.assert_allclose(got.temperature, want, atol=1e-7)


EVERYTHING: Effects = {
    "actuator_delay": {"delay_s": 0.77},
    "sensor_lag": {"tau_s": 1.3},
    "film_lag": {"tau_s": 0.6},
    "self_heating": {"theta_K_per_W": 700.0},
    "film_drift": {"drift_K_per_h": 1.0},
    "creep": {"share": 0.1, "tau_s": 90.0},
    "meter_lag": {"tau_s": 0.9},
    "timestamp_skew": {"skew_s": -0.33},
    "series_resistance": {"series_ohm": 20.0},
    "parallel_leakage": {"leakage_ohm": 1e6},
}


def test_half_the_step_changes_nothing(bench: Bench) -> None:
    for effects in ({}, EVERYTHING):
        assert furthest(opened(bench, effects), opened(bench, effects, step_s=0.01), bench) < 0.05


WEAK: dict[str, dict[str, float]] = {
    "actuator_delay": {"delay_s": 1e-6},
    "actuator_deadband": {"deadband_A": 1e-9},
    "heat_sink_warmup": {"sink_capacity_ratio": 1e4, "sink_conductance_ratio_per_s": 1e4},
    "radiative_loss": {"loss_per_K3_s": 1e-18},
    "ambient_drift": {"drift_K_per_h": 1e-6},
    "sensor_lag": {"tau_s": 1e-3},
    "film_lag": {"tau_s": 1e-3},
    "self_heating": {"theta_K_per_W": 1e-4},
    "film_drift": {"drift_K_per_h": 1e-6},
    "creep": {"share": 1e-6, "tau_s": 100.0},
    "meter_lag": {"tau_s": 1e-4},
    "timestamp_skew": {"skew_s": 1e-5},
    "series_resistance": {"series_ohm": 1e-4},
    "parallel_leakage": {"leakage_ohm": 1e13},
    "meter_range_error": {"threshold_ohm": 1e4, "error": 1e-7},
}


@pytest.mark.parametrize("name", WEAK)
def test_an_effect_of_no_size_is_no_effect(name: str) -> None:
    short = draw_bench(np.random.default_rng(5), rows=700)
    assert furthest(opened(short), opened(short, {name: WEAK[name]}), short) < 0.2


def test_delay_and_skew_are_exact_between_the_samples(bench: Bench) -> None:
    late = opened(bench, {"actuator_delay": {"delay_s": 0.73}})
    plain = opened(bench)
    time = bench.schedule.time[20:-20]
    # before the first current the plate only relaxes to the room, hence the tolerance
    shifted = np.interp(time - 0.73, plain.fine_time, plain.fine_plate)
    np.testing.assert_allclose(np.interp(time, late.fine_time, late.fine_plate), shifted, atol=0.02)
    for skew in (0.37, -0.37):
        read = opened(bench, {"timestamp_skew": {"skew_s": skew}})
        fine = opened(bench)
        earlier = np.interp(bench.schedule.time - skew, bench.schedule.time, fine.log_ohm)
        assert np.median(np.abs(read.log_ohm - earlier)) < 1e-3


@pytest.mark.parametrize("kind", FILMS)
def test_films_forget_closed_loops_and_do_not_know_time(kind: str) -> None:
    for seed in range(4):
        film = draw_film(np.random.default_rng(seed), kind)
        middle = 60.0
        inner = np.concatenate([np.linspace(middle, middle + 6, 40), np.linspace(middle + 6, middle - 5, 70)])
        to, back = np.linspace(30.0, middle, 90), np.linspace(middle - 5, 95.0, 200)
        loop = film.log_ohm(np.concatenate([to, inner, back]))
        without = film.log_ohm(np.concatenate([to, inner[:40], inner[39:], back]))
        np.testing.assert_allclose(loop[-200:], without[-200:], atol=1e-12)
        around = np.concatenate([np.linspace(25, 58, 60), np.linspace(58, 64, 30), np.linspace(64, 58, 30)])
        once = film.log_ohm(np.concatenate([around, around[60:]]))
        np.testing.assert_allclose(once[89], once[149], atol=1e-9)  # the same small loop ends where it did
        slow = film.log_ohm(np.interp(np.linspace(0, 1, 4001), np.linspace(0, 1, 120), around))
        np.testing.assert_allclose(slow[-1], film.log_ohm(around)[-1], atol=2e-3)


@pytest.mark.parametrize("kind", FILMS)
def test_films_fall_with_temperature_and_have_loops(kind: str) -> None:
    for seed in range(6):
        film = draw_film(np.random.default_rng(seed), kind)
        up, down = np.linspace(20.0, 100.0, 500), np.linspace(100.0, 20.0, 500)
        y = film.log_ohm(np.concatenate([up, down]))
        assert np.all(np.diff(y[:500]) <= 1e-12)
        assert np.all(np.diff(y[500:]) >= -1e-12)
        assert 1.2 < y[0] - y[499] < 4.3
        assert y.min() > 0.5
        assert y.max() < 6.2
        assert np.max(y[:500] - y[999:499:-1]) > 0.1


def test_relays_in_a_field_switch_where_the_field_puts_them() -> None:
    film = draw_film(np.random.default_rng(1), "moving", form=0)
    t = np.concatenate((np.linspace(20.0, 100.0, 400), np.linspace(100.0, 20.0, 400)))
    y = film.log_ohm(t)
    metal = (y[0] - y) / (y[0] - y[399])
    seen = t + film.table[4, 0] * (metal - 0.5)
    alone = replace(film, kind=PREISACH, table=film.table[:4]).log_ohm(seen)
    np.testing.assert_allclose(y, alone, atol=1e-5)


def test_a_mixture_percolates_at_a_half_and_at_a_third() -> None:
    """Bruggeman's medium of d dimensions: the metal alone conducts (d f - 1) / (d - 1) of what it does, f > 1 / d."""
    t, decades = np.linspace(20.0, 110.0, 600), 9.0
    for dimensions in (2, 3):
        film = draw_film(np.random.default_rng(2), "medium", form=0)
        table = film.table.copy()
        table[1] *= decades / np.sum(table[1])
        table[4] = dimensions
        relays = replace(film, kind=PREISACH, table=table[:4]).log_ohm(t)
        mixture = replace(film, table=table).log_ohm(t)
        metal, gained = (relays[0] - relays) / decades, mixture[0] - mixture
        some = metal > 1.0 / dimensions + 0.05
        conducts = (dimensions * metal[some] - 1.0) / (dimensions - 1.0)
        np.testing.assert_allclose(gained[some], decades + np.log10(conducts), atol=1e-3)
        assert np.max(gained[metal < 1.0 / dimensions - 0.05]) < 1.5
        assert gained[-1] == pytest.approx(decades, abs=1e-3)


@pytest.mark.parametrize("exponent", [-1.0, -0.4, 0.0, 0.5, 1.0])
def test_domains_mix_as_the_exponent_says(exponent: float) -> None:
    film = draw_film(np.random.default_rng(4), "mixed", form=0)
    table, t = film.table.copy(), np.concatenate((np.linspace(20.0, 100.0, 400), np.linspace(100.0, 20.0, 400)))
    table[4] = exponent
    relays = replace(film, kind=PREISACH, table=table[:4], d=np.zeros(4)).log_ohm(t)
    decades = float(np.sum(table[1]))
    metal = -relays / decades
    insulator = 10.0 ** (decades + table[5, 0] * (1.0 / (t + 273.15) - 1.0 / 333.15))  # over the metal's resistance
    ohm = 10.0 ** (replace(film, table=table, d=np.zeros(4)).log_ohm(t) + decades)
    if exponent == 0.0:
        np.testing.assert_allclose(np.log10(ohm), (1.0 - metal) * np.log10(insulator), atol=1e-9)
    else:
        np.testing.assert_allclose(ohm**exponent, (1.0 - metal) * insulator**exponent + metal, rtol=1e-8)


def test_order_condition_holds() -> None:
    v = np.linspace(0.0, 120.0, 2401)
    for seed in range(10):
        table = draw_film(np.random.default_rng(seed)).table
        rising, falling = (np.tanh(table[2, k] * v + table[2, k + 1]) for k in (0, 2))
        assert np.max(rising - falling) <= 2.0 * table[0].min()


def test_noise_is_as_asked_and_readings_are_rounded() -> None:
    clean = case("clean", 11)
    assert clean.bench is not None
    bench = clean.bench
    truth = simulate(bench.rig, replace(bench.schedule, setpoint=None, current=clean.columns["current_A"]))
    for reading, want, size in (
        (clean.columns["temperature_degC"], truth.temperature, bench.rig.noise_K),
        (np.log10(clean.columns["resistance_ohm"]), truth.log_ohm, bench.rig.noise_dec),
    ):
        assert np.std(reading - want) == pytest.approx(size, rel=0.05)
        assert abs(np.mean(reading - want)) < 5 * size / np.sqrt(reading.size)
    rough = case("one", 0, effect="thermometer_quantization")
    step = rough.hidden["thermometer_quantization"]["step_K"]
    steps = rough.columns["temperature_degC"] / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_a_case_depends_on_its_seed_alone(tmp_path: Path) -> None:
    one, again, other = (case("one", seed, effect="creep") for seed in (1, 1, 2))
    assert one.hidden == again.hidden != other.hidden
    for name, values in one.columns.items():
        np.testing.assert_array_equal(values, again.columns[name])
    write_record(one, tmp_path / "record.csv")
    read = np.genfromtxt(tmp_path / "record.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(read["resistance_ohm"], one.columns["resistance_ohm"])
    assert one.details["smallest_share"]["creep"] <= 0.25


def test_the_oracle_takes_no_curvature_for_evidence() -> None:
    """A small effect's log-likelihood ratio goes with the square of its size, whatever plate and film follow."""
    bench = draw_bench(np.random.default_rng(3), rows=1600)
    oracle = Oracle(bench.rig, bench.schedule, recorded_current(bench, {}), cautious=False)
    for name, parameters in (
        ("radiative_loss", {"loss_per_K3_s": 2e-11 / bench.rig.plate.capacity_J_per_K}),
        ("self_heating", {"theta_K_per_W": 300.0}),
        ("film_drift", {"drift_K_per_h": 0.3}),
    ):
        whole = oracle.evidence({name: parameters})
        tenth = oracle.evidence({name: weaker(name, parameters, 0.1)})
        assert tenth > 0.0
        assert whole / tenth == pytest.approx(100.0, rel=0.25), name


def test_disturbances_leave_a_record() -> None:
    columns = case("clean", 4).columns
    rough = disturbed(np.random.default_rng(0), columns, DISTURBANCES)
    assert np.all(np.diff(rough["time_s"]) > 0.0)
    assert 5000 < rough["time_s"].size < 6000
    assert np.isnan(rough["resistance_ohm"]).any()
    assert not np.isnan(columns["resistance_ohm"]).any()


def test_pairs_that_are_alike_are_not_asked_for() -> None:
    assert not allowed(("creep", "meter_lag", "timestamp_skew"))
    assert allowed(("film_lag", "meter_lag"))


def said(*names: str, verdict: str = "explained", alike: tuple[str, ...] = ()) -> dict[str, object]:
    """A document that names these."""
    effects = [
        {
            "name": name,
            "parameters": {"tau_s": {"value": 1.0, "ci95": [0.9, 1.1]}},
            "evidence": 100.0,
            "false_alarm": 0.003,
            "indistinguishable_from": list(alike),
        }
        for name in names
    ]
    return {"verdict": verdict, "effects": effects, "channels": {"temperature_K": None}, "unexplained": {"a": None}}


def truth(kind: str, expectation: str, hidden: Effects, acceptable: tuple[str, ...] = ()) -> Case:
    return Case(kind, 0, {}, hidden, expectation, "of_class", {}, acceptable)


def test_scores() -> None:
    lag = {"film_lag": {"tau_s": 1.05}}
    one = truth("one", "exactly", lag)
    assert score(one, said("film_lag"))["ok"]
    assert score(one, said("film_lag"))["intervals"] == [("film_lag", "tau_s", True, pytest.approx(0.2 / 1.05))]
    assert not score(one, said("film_lag", "creep"))["ok"]
    assert score(one, said("creep"))["innocents"] == ["creep"]
    assert score(truth("clean", "clean", {}), said(verdict="clean"))["ok"]
    assert not score(truth("outside", "unexplained", {}), said(verdict="clean"))["ok"]
    assert score(truth("other_film", "no_name", {}), said("creep"))["ok"]
    assert not score(truth("other_film", "no_name", {}), said("meter_lag"))["ok"]
    both = truth("indistinguishable", "set", lag, ("film_lag", "meter_lag"))
    assert named_as_set(both, said("meter_lag", alike=("film_lag",)))
    assert not named_as_set(both, said("meter_lag"))
    assert score(both, said("meter_lag", alike=("film_lag",)), said("film_lag"))["decided"]
    assert wilson(99, 100)[0] == pytest.approx(0.9455, abs=1e-3)
