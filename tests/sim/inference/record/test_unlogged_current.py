"""Records whose current changed between their rows: it is seen, and the same is named as in the whole record."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.report.diagnosis_words import sentence
from sim.diagnosis.diagnose import diagnose
from sim.inference.record.record import read_columns
from sim.inference.record.unlogged_current import MOST, acted_before
from sim.world.plant import World, simulate_record
from tests.sim.diagnosis.said import names
from tests.sim.small_chain import FILM, PLATE, on
from tests.truth import record

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
    steps = np.repeat(np.random.default_rng(1).uniform(0.3, 1.8, 160), 19)[:3000]
    for columns in (record(1, current=steps), steps_and_waves(1)):
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


@pytest.mark.parametrize(("rows", "own"), [(2, True), (4, False)])
def test_a_clean_record_stays_clean(rows: int, own: bool) -> None:
    """Of `tests/truth.py` with ramps and corners, and of `simulate`: "unexplained" as long as a current was
    taken to be held from row to row."""
    columns = steps_and_waves(2) if own else record(2)
    found = diagnose(every(columns, rows))
    document = found.document()
    assert names(document) == set()
    assert document["verdict"] == "clean"
    assert "The model is off in held-out rows" in sentence(found)
    assert "current_between_rows" in {warning["code"] for warning in document["warnings"]}
    assert any("current_time_s" in text for text in document["next_experiment"])


def test_a_whole_record_is_read_as_it_was() -> None:
    document = diagnose(every(record(2), 1)).document()
    assert document["verdict"] == "clean"
    assert "current_between_rows" not in {warning["code"] for warning in document["warnings"]}
