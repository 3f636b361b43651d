"""Records whose current changed between their rows: it is seen, and the same is named as in the whole record."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.analysis.diagnosed import possible_kinds
from rig.records.record_file import Record
from rig.report.diagnosis_words import left_over
from sim.diagnosis.data.between_rows import MOST, acted_before
from sim.diagnosis.data.record import read_columns
from sim.diagnosis.data.wandering import Wandering, WanderingWhitening
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.fit.temperature_channel import TemperatureChannel
from sim.diagnosis.judge import turns_between
from sim.diagnosis.search.chain import temperature_search
from sim.effects.catalogue import catalogue
from sim.world.open_loop import simulate_record
from sim.world.world import World
from tests.diagnosis.cases import case
from tests.diagnosis.said import covered, names
from tests.sim.small_chain import FILM, PLATE, on

Columns = dict[str, NDArray[np.float64]]
PLATE_COLUMNS = ("time_s", "temperature_degC", "current_A")
NOWHERE = np.empty(0, dtype=np.int64)


def every(columns: Columns, rows: int, first: int = 0) -> Columns:
    """A log that kept one row of so many, of a plate alone."""
    return {name: columns[name][first::rows] for name in PLATE_COLUMNS}


def steps_and_waves(seed: int, *effects: str) -> Columns:
    """`peltier simulate` of a plate whose current goes up and down, with a step every 9.5 s."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 1500.0, 0.5)
    steps = np.repeat(rng.uniform(-0.6, 0.9, time.size // 19 + 1), 19)[: time.size]
    current = 0.7 + steps + 0.5 * np.sin(time / 41.0)
    world = World(PLATE, FILM, 40.0, thermometer_noise_K=0.01, seed=seed, effects=tuple(on(name) for name in effects))
    shown = simulate_record(world, time, current)
    return {"time_s": time, "temperature_degC": shown.temperature_degC, "current_A": current}


@pytest.mark.parametrize(("rows", "share"), [(1, 0.0), (2, 0.25), (4, 0.375)])
def test_a_bend_before_its_current_is_seen(rows: int, share: float) -> None:
    """Of n commands from row to row (n - 1) / 2n of a change has acted before its row; in a whole record nothing."""
    for columns in (case("clean", 1).columns, steps_and_waves(1)):
        found = acted_before(*every(columns, rows).values(), NOWHERE)
        assert found == pytest.approx(share, abs=0.06)
        assert found <= MOST


def test_two_steps_at_the_start_tell_nothing() -> None:
    """Each of their few bends is met by a coefficient of its own, and looked as sure as no reading is."""
    time = np.arange(0.0, 500.0, 0.25)
    current = 1.0 + 0.3 * np.sin(time / 60.0)
    current[14:16] += 0.39
    still = simulate_record(World(PLATE, FILM, 40.0, thermometer_noise_K=0.0), time, current).temperature_degC
    for seed in range(50):
        shown = still + 0.02 * np.random.default_rng(seed).standard_normal(time.size)
        assert acted_before(time, shown, np.round(current, 4), NOWHERE) == 0.0, seed


def test_where_the_record_says_when_a_current_acts_nothing_is_guessed() -> None:
    columns = every(steps_and_waves(1), 4)
    assert read_columns(columns).early > 0.0
    assert read_columns({**columns, "current_time_s": columns["time_s"]}).early == 0.0


@pytest.mark.parametrize("rows", [2, 4])
@pytest.mark.parametrize("own", [False, True])
def test_a_clean_record_stays_clean(rows: int, own: bool) -> None:
    """Of this generator's closed loop with ramps and corners, and of `simulate`: "unexplained" as long as a current was
    taken to be held from row to row."""
    columns = steps_and_waves(2) if own else case("clean", 1).columns
    found = diagnose(every(columns, rows))
    document = found.document()
    assert names(document) == set()
    assert document["verdict"] == "clean"
    assert left_over(found)  # what the simulation is off by is said, and why
    assert all("between the rows" in line for line in left_over(found))
    assert "current_between_rows" in {warning["code"] for warning in document["warnings"]}
    assert any("current_time_s" in text for text in document["next_experiment"])


def test_a_whole_record_is_read_as_it_was() -> None:
    document = diagnose(every(case("clean", 1).columns, 1)).document()
    assert document["verdict"] == "clean"
    assert "current_between_rows" not in {warning["code"] for warning in document["warnings"]}


@pytest.mark.long
def test_the_same_is_named_at_another_sampling() -> None:
    blind = case("one", 5)
    assert set(blind.hidden) == {"ambient_drift"}
    whole, thinned = (diagnose(every(blind.columns, rows)).document() for rows in (1, 2))
    assert names(whole) == names(thinned) == set(blind.hidden)
    covered(thinned, blind)


@pytest.mark.parametrize("name", ["radiative_loss", pytest.param("heat_sink_warmup", marks=pytest.mark.long)])
def test_a_simulation_that_wanders_speaks_against_no_name(name: str) -> None:
    blind = case("one", 900, effect=name)
    document = diagnose(every(blind.columns, 2)).document()
    assert names(document) == {name}
    assert document["verdict"] == "explained"


@pytest.mark.long
def test_an_ohmmeter_behind_a_thinned_log_is_named() -> None:
    blind = case("one", 8)
    assert set(blind.hidden) == {"meter_lag"}
    document = diagnose({name: values[::2] for name, values in blind.columns.items()}).document()
    assert names(document) == set(blind.hidden)
    covered(document, blind)


def test_a_plate_that_wanders_is_whitened() -> None:
    rng, size = np.random.default_rng(3), 20_000
    keep, added = np.full(size, 0.97), np.where(rng.random(size) < 0.05, 0.3, 0.01) ** 2
    keep[0] = added[0] = 0.0
    d = np.zeros(size)
    for k in range(1, size):
        d[k] = keep[k] * d[k - 1] + np.sqrt(added[k]) * rng.standard_normal()
    readings = d + 0.02 * rng.standard_normal(size)
    z = WanderingWhitening(keep, added, np.full(size, 0.02)).over(readings)
    assert np.mean(z * z) == pytest.approx(1.0, abs=0.05)
    assert abs(float(np.mean(z[1:] * z[:-1]))) < 0.03
    rows = np.flatnonzero(rng.random(size) < 0.7)
    walk = Wandering(keep, added)
    some = walk.whitening(rows, np.full(rows.size, 0.02)).over(readings[rows])
    assert np.mean(some * some) == pytest.approx(1.0, abs=0.05)
    smoothed = walk.smoothed(readings[rows], rows, np.full(rows.size, 0.02))
    assert np.std(smoothed[rows] - d[rows]) < 0.02 < np.std(d)
    assert np.std(d) == pytest.approx(float(np.sqrt(np.mean(walk.deviation**2))), rel=0.2)


@pytest.mark.parametrize("clean", [True, False])
def test_a_heater_is_tried_where_a_peltier_plate_leaves_something(clean: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a drive in ampere that never cools nor a duty says of which kind the plate is."""
    columns = steps_and_waves(4)
    columns["current_A"] -= np.min(columns["current_A"])
    world = World(PLATE, FILM, 40.0, thermometer_noise_K=0.01, seed=4)
    shown = simulate_record(world, columns["time_s"], columns["current_A"]).temperature_degC
    columns["temperature_degC"] = shown if clean else shown + 0.1 * np.sin(columns["time_s"] / 60.0)
    kinds = possible_kinds([Record(columns, "record.csv")], None)
    assert kinds == ("peltier", "heater")
    cooled = Record({**columns, "current_A": -columns["current_A"]}, "record.csv")
    assert possible_kinds([cooled], None) == ("peltier",)
    begun, start = [], TemperatureChannel.start

    def counted(self: TemperatureChannel, kind: str, *rest: object) -> object:
        begun.append(kind)
        return start(self, kind, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(TemperatureChannel, "start", counted)
    record = replace(read_columns(columns), early=0.0)
    found = temperature_search(record, catalogue(), kinds)
    assert found.base.parameters.kind == "peltier"
    assert ("heater" in begun) is not clean


def test_where_every_current_is_logged_there_is_no_turn_between_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though what is left is small."""
    monkeypatch.setattr(turns_between, "resistance_residual", lambda chain, names: (np.full(100, 0.9), None))
    chain: Any = SimpleNamespace(fits=lambda names: (None, None), first=None, facts=None)
    left = {"temperature_K": None, "resistance_dec": "structure in blocks of 12 rows"}
    assert not turns_between.only_turns(chain, frozenset(), left)
