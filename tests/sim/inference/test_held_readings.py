"""A meter that is slower than the rows repeats its readings; one that rounds repeats some, honestly."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from sim.inference.film.fit import identify_film
from sim.inference.readings.odd_readings import repeated_rows
from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii, through

MEASURED = Path(os.environ.get("PELTIER_DATA", Path(__file__).parents[3] / "shared" / "data"))


def course(rows: int = 6000) -> tuple[np.ndarray, np.ndarray]:
    """Temperature and output of a film at 10 Hz, with dwells."""
    v = decaying_profile(rows - 1000, 10)
    v = np.concatenate((v[:1500], np.full(500, v[1500]), v[1500:3000], np.full(500, v[3000]), v[3000:]))
    film = is_prandtl_ishlinskii(1)
    return v, film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0]


def rounded(y: np.ndarray, counts: float) -> np.ndarray:
    """As a meter with so many counts shows it, in ranges of a decade."""
    ohm = 10.0**-y
    step = 10.0 ** np.ceil(np.log10(ohm)) / counts
    return -np.log10(np.round(ohm / step) * step)


@pytest.mark.parametrize("counts", [0.0, 2e4, 2e6])
@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_of_a_meter_that_is_asked_too_often_one_row_a_reading_counts(counts: float, noise: float) -> None:
    v, y = course()
    y = y + noise * np.random.default_rng(0).normal(size=v.size)
    mean = y[: v.size // 10 * 10].reshape(-1, 10).mean(axis=1)
    held = np.repeat(mean, 10)
    shown = rounded(held, counts) if counts else held
    again = repeated_rows(shown)
    assert again.size >= 0.9 * shown.size - 1
    assert np.all(shown[again] == shown[again - 1])


@pytest.mark.parametrize("counts", [2e3, 2e4, 2e5, 2e6])
@pytest.mark.parametrize("noise", [0.0, 2e-5, 0.0005])
@pytest.mark.parametrize("every", [1, 7])
def test_a_rounded_meter_repeats_honestly(counts: float, noise: float, every: int) -> None:
    v, y = course()
    y = y + noise * np.random.default_rng(0).normal(size=v.size)
    assert repeated_rows(rounded(y, counts)[::every]).size == 0


def test_a_slow_rounded_sweep_and_a_long_rest_are_honest() -> None:
    v = through([62.0, 62.5, 62.0], 6000)
    film = is_prandtl_ishlinskii(1)
    y = film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0]
    assert repeated_rows(rounded(y, 2e4)).size == 0
    rest = y[0] + 1e-5 * np.random.default_rng(0).normal(size=6000)
    assert repeated_rows(rounded(rest, 2e4)).size == 0


def test_few_or_no_readings_say_nothing() -> None:
    assert repeated_rows(np.full(10, np.nan)).size == 0
    assert repeated_rows(np.repeat(np.arange(5.0), 10)).size == 0
    assert repeated_rows(np.empty(0)).size == 0


def test_measured_films_repeat_nothing() -> None:
    if not MEASURED.is_dir():
        pytest.skip(f"no measured records: {MEASURED} is not there (set PELTIER_DATA)")
    assert repeated_rows(-np.log10(np.loadtxt(MEASURED / "vo2_film_major_loop.tsv", skiprows=1)[:, 2])).size == 0
    assert repeated_rows(-np.log10(np.loadtxt(MEASURED / "vo2_film_small_gap_raw.tsv", skiprows=3)[:, 1])).size == 0


def test_identification_counts_each_reading_once_and_says_so() -> None:
    v, y = course()
    noise = 0.002 * np.random.default_rng(4).normal(size=v.size // 10)
    held = np.repeat(y[::10] + noise, 10)
    time = 0.1 * np.arange(v.size)
    fit = identify_film(time, v, held, kind="generalized_pi")
    (note,) = [line for line in fit.identifiability if "rows on average" in line]
    assert "stands in 10.0 rows on average" in note
    assert "600 are left" in note
    once = identify_film(time, v, np.where(np.arange(v.size) % 10 == 0, held, np.nan), kind="generalized_pi")
    assert fit.rmse == pytest.approx(once.rmse, rel=1e-9)
    np.testing.assert_allclose(fit.outer_standard_errors, once.outer_standard_errors, rtol=1e-9)
