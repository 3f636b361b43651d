"""Noise of another colour than neighbouring rows that share a part: told from its residual, and from what is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.diagnosis.data.noise_colour import ColouredWhitening, NoiseColour, noise_colour
from sim.diagnosis.data.noise_estimate import noise_of
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.judge import coloured_noise
from sim.diagnosis.search.budget import Budget
from tests.diagnosis.cases import case
from tests.diagnosis.said import names
from tests.diagnosis.truth.real_noise import COLOURS, coloured

Array = NDArray[np.float64]
ROWS = 6000
BOTH = {"thermometer", "ohmmeter"}
EVERY = np.arange(ROWS)


def noise(colour: str, seed: int) -> Array:
    return coloured(np.random.default_rng(seed), ROWS, colour)


def colour_of(x: Array) -> NoiseColour:
    found = noise_colour(x, np.arange(x.size))
    assert found is not None
    return found


def correlated(u: Array, apart: int) -> float:
    """Of rows so far apart."""
    return float(np.mean(u[apart:] * u[:-apart]))


@pytest.mark.parametrize("colour", COLOURS)
def test_over_its_noise_it_is_white_and_of_variance_1(colour: str) -> None:
    x = noise(colour, 1)
    whitening = ColouredWhitening(np.ones(ROWS), colour_of(x), np.array([0]), np.ones(ROWS))
    u = whitening.over(x)
    assert float(np.mean(u * u)) == pytest.approx(1.0, abs=0.1)
    assert max(abs(correlated(u, apart)) for apart in (1, 2, 3, 5, 10, 30, 100)) < 0.1
    assert whitening.over(np.stack((x, x), axis=1))[:, 1] == pytest.approx(u)


@pytest.mark.parametrize("colour", COLOURS)
def test_rows_before_which_nothing_is_known_are_of_variance_1(colour: str) -> None:
    """In each place of stretches that begin anew."""
    x = coloured(np.random.default_rng(2), 20 * ROWS, colour)
    found = colour_of(x[:ROWS])
    begins = np.arange(0, x.size, 60)
    u = ColouredWhitening(np.ones(x.size), found, begins, np.ones(x.size)).over(x).reshape(-1, 60)
    of_each_place = np.mean(u**2, axis=0)
    assert of_each_place == pytest.approx(np.ones(60), abs=0.2)


def test_what_is_slow_is_no_noise() -> None:
    """A misfit as large as the noise, over 600 rows: a tenth of the variance still shows, five times what is let go."""
    white = np.random.default_rng(3).standard_normal(ROWS)
    slow = np.sqrt(2.0) * np.sin(2.0 * np.pi * EVERY / 600.0)
    found = colour_of(white + slow)
    left = ColouredWhitening(np.ones(ROWS), found, np.array([0]), np.ones(ROWS)).over(slow)
    assert float(np.mean(left**2)) > 0.1


def test_readings_far_out_and_missing_rows_change_no_colour() -> None:
    x, rng = noise("two_poles", 4), np.random.default_rng(5)
    before = colour_of(x)
    x[rng.choice(ROWS, 20, replace=False)] += 50.0
    kept = np.delete(EVERY, rng.choice(ROWS, 10, replace=False))
    after = noise_colour(x[kept], kept)
    assert after is not None
    assert after.taps[:4] == pytest.approx(before.taps[:4], abs=0.2)
    assert noise_colour(x[::2], EVERY[::2]) is None  # every second row is missing
    assert noise_colour(x[:1000], EVERY[:1000]) is None


def test_the_noise_of_a_channel_may_have_one() -> None:
    x = 2e-3 * noise("moving_mean", 6)
    readings, every = 2.0 * np.sin(EVERY / 300.0), np.ones(ROWS, dtype=np.bool_)
    told = noise_of(x, readings, every, every, 1e-6, coloured=True)
    assert told.colour is not None
    assert told.level == pytest.approx(2e-3, rel=0.15)
    assert not told.alike(noise_of(x, readings, every, every, 1e-6), readings, 0.5)
    assert told.alike(noise_of(x + 1e-9, readings, every, every, 1e-6, coloured=True), readings, 0.01)


@pytest.mark.parametrize("seed", [0, 2, 10])
def test_a_record_with_such_noise_is_clean(seed: int) -> None:
    found = diagnose(case("coloured_noise", seed).columns).document()
    assert found["verdict"] == "clean"
    assert [w["code"] for w in found["warnings"]].count("coloured_noise") == 1


@dataclass(frozen=True)
class Searched:
    """Stands for a chain of which only the instruments with such noise matter."""

    coloured: frozenset[str] = frozenset()
    sparse: None = None
    budget: Budget = field(default_factory=Budget)


@pytest.mark.parametrize(
    ("leaves", "tried", "kept"),
    [
        (set(), [BOTH], BOTH),
        ({"ohmmeter"}, [BOTH, {"thermometer"}], {"thermometer"}),  # a film in steps: what it leaves is no noise
        ({"thermometer"}, [BOTH], set()),  # what drives the film is not understood
        (BOTH, [BOTH], set()),
    ],
)
def test_where_one_leaves_something_the_other_is_tried_alone(
    monkeypatch: pytest.MonkeyPatch, leaves: set[str], tried: list[set[str]], kept: set[str]
) -> None:
    """leaves: the instruments that leave something beside such noise, too; tried, kept: those with such noise."""
    searched: list[Any] = []
    monkeypatch.setattr(coloured_noise, "_passing", lambda chain, judged: BOTH - chain.coloured)
    monkeypatch.setattr(coloured_noise, "_left", lambda judged: leaves | BOTH - judged.coloured)
    monkeypatch.setattr(coloured_noise, "select", lambda chain, say: searched.append(chain) or (chain, frozenset()))
    monkeypatch.setattr(
        coloured_noise, "judge", lambda chain, names: SimpleNamespace(clean=False, coloured=chain.coloured)
    )
    begun: Any = Searched()
    first: Any = SimpleNamespace(clean=False, coloured=frozenset())
    found, _, _ = coloured_noise.beside_coloured_noise(begun, (begun, frozenset(), first), lambda text: None)
    assert [set(chain.coloured) for chain in searched] == tried
    assert found.coloured == kept


@pytest.mark.long
@pytest.mark.parametrize("fault", ["pickup", "bad_joint", "sticking_thermometer", "fan_stops"])
def test_a_fault_beside_such_noise_is_no_noise(fault: str) -> None:
    found = diagnose(case("coloured_noise", 1, fault=fault).columns).document()
    assert names(found) == set()
    assert found["verdict"] == "unexplained"
