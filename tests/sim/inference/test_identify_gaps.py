"""Films whose records lack rows: what the film went through there is unknown, and found from what follows."""

from __future__ import annotations

import numpy as np
import pytest

from sim.inference.film.fit import identify_film, identify_film_records
from sim.inference.film.rows import FilmRecord, prepare
from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii, through

NOISE = 0.002
GAP = 871


def with_an_excursion(to_degC: float | None, seed: int = 1) -> tuple[np.ndarray, ...]:
    """time_s, temperature_degC and output of a film in decaying loops; on its way through 62 degC the record stops in
    row GAP - 1, the plate goes on, turns round later than the loops do, and comes back within 200 s."""
    v = decaying_profile(2400, 12)
    v = v if to_degC is None or to_degC > 62.0 else 124.0 - v
    excursion = np.empty(0) if to_degC is None else through([v[GAP - 1], to_degC, v[GAP - 1]], 401)[1:]
    whole = np.concatenate((v[:GAP], excursion, v[GAP:]))
    film = is_prandtl_ishlinskii(seed)
    y = film.simulate(whole, film.initial_memory(float(whole[0]), "cooled" if whole[0] > 62.0 else "heated"))[0]
    y = np.delete(y, slice(GAP, GAP + excursion.size)) + NOISE * np.random.default_rng(3).normal(size=v.size)
    time = 0.5 * np.arange(v.size)
    time[GAP:] += 200.0
    return time, v, y


@pytest.mark.parametrize("to_degC", [86.0, 38.0])
def test_the_film_begins_anew_after_a_gap(to_degC: float) -> None:
    time, v, y = with_an_excursion(to_degC)
    fit = identify_film(time, v, y, kind="extended_generalized_pi", form="tanh")
    assert fit.rmse < 1.05 * NOISE
    ((at_s, passed),) = fit.starts[0].passed_degC
    assert at_s == time[GAP]
    assert passed[0] > 70.0 if to_degC > 62.0 else passed[0] < 54.0  # beyond which the film is saturated
    assert [note for note in fit.identifiability if "1 gap in time, of 200 s" in note and "anew" in note]
    left = fit.along(0, time, v) - y
    assert float(np.sqrt(np.mean(left**2))) == pytest.approx(fit.rmse, rel=1e-6)


def test_a_gap_without_an_excursion_keeps_the_memory() -> None:
    time, v, y = with_an_excursion(None)
    fit = identify_film(time, v, y, kind="extended_generalized_pi", form="tanh")
    assert fit.rmse < 1.03 * NOISE
    assert fit.starts[0].passed_degC == ()
    assert any("no excursion shows" in note for note in fit.identifiability)


def test_of_a_short_gap_it_is_only_told() -> None:
    time, v, y = with_an_excursion(None)
    rows = np.delete(np.arange(GAP), slice(600, 603))
    record = prepare(FilmRecord(time[rows], v[rows], y[rows]))
    assert record.gaps.tolist() == [600]
    assert record.unseen.size == 0
    rng = np.random.default_rng(0)
    uneven = prepare(FilmRecord(np.cumsum(rng.uniform(0.25, 0.75, GAP)), v[:GAP], y[:GAP]))
    assert uneven.gaps.size == 0
    assert prepare(FilmRecord(time[:GAP:7], v[:GAP:7], y[:GAP:7])).gaps.size == 0


def test_a_thermometer_without_readings_is_a_gap_too() -> None:
    time, v, y = with_an_excursion(None)
    lost = v.copy()
    lost[300:340] = np.nan
    record = prepare(FilmRecord(time, lost, y))
    assert record.rows[record.unseen].tolist() == [340, GAP]
    assert record.gap_s.tolist() == [time[340] - time[299], time[GAP] - time[GAP - 1]]


@pytest.mark.parametrize("late_s", [-3.3, -0.2, 0.2])
def test_no_reading_is_taken_within_a_gap(late_s: float) -> None:
    """A reading that is stamped there counts at its end: the film has been wherever it was in it before that."""
    time, v, y = with_an_excursion(None)
    record = prepare(FilmRecord(time, v, y, output_time_s=time + late_s))
    assert record.gap_s.tolist() == [time[GAP] - time[GAP - 1]]
    assert np.max(record.taken_s[:GAP]) <= time[GAP - 1]
    assert np.min(record.taken_s[GAP:]) >= time[GAP]
    inside = slice(20, GAP - 20)
    np.testing.assert_allclose(record.taken_s[inside], time[inside] + late_s)


def test_rows_after_a_gap_that_have_no_temperature_are_of_the_same_gap() -> None:
    time, v, y = with_an_excursion(None)
    lost = v.copy()
    lost[GAP : GAP + 20] = np.nan
    record = prepare(FilmRecord(time, lost, y))
    assert record.rows[record.gaps].tolist() == record.rows[record.unseen].tolist() == [GAP + 20]
    assert record.gap_s.tolist() == [time[GAP + 20] - time[GAP - 1]]


def test_each_record_has_gaps_of_its_own() -> None:
    hot, cold = with_an_excursion(86.0), with_an_excursion(38.0)
    records = [FilmRecord(*hot, "hot"), FilmRecord(*cold, "cold")]
    fit = identify_film_records(records, kind="extended_generalized_pi", form="tanh")
    assert fit.rmse < 1.05 * NOISE
    assert fit.starts[0].passed_degC[0][1][0] > 70.0
    assert fit.starts[1].passed_degC[0][1][0] < 54.0
