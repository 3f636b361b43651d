"""Films whose records lack rows: what the film went through there is unknown, and found from what follows."""

from __future__ import annotations

import numpy as np
import pytest

from sim.inference.film.fit import FilmRecord, identify_film, identify_film_records
from sim.inference.film.rows import build_path, prepare
from sim.model.record_own import FilmStart
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
    assert record.unseen.tolist() == [340, GAP]
    assert record.gap_s.tolist() == [time[340] - time[299], time[GAP] - time[GAP - 1]]


@pytest.mark.parametrize("late_s", [-0.2, 0.2])
def test_a_gap_is_as_long_as_its_rows_say_and_where_no_reading_is(late_s: float) -> None:
    """A reading from before its row lies within the gap: the film has been wherever it was in it before that."""
    time, v, y = with_an_excursion(None)
    plain = prepare(FilmRecord(time, v, y))
    record = prepare(FilmRecord(time, v, y, output_time_s=time + late_s))
    assert record.gap_s.tolist() == plain.gap_s.tolist() == [time[GAP] - time[GAP - 1]]
    (row,) = record.unseen
    between = (time[GAP - 1] + max(late_s, 0.0), time[GAP] + min(late_s, 0.0))
    assert record.time_s[[row - 1, row]] == pytest.approx(between)
    assert record.longest_unseen.tolist() == [row]


@pytest.mark.parametrize("late_s", [-0.1, -1.3, -3.3])
def test_readings_of_rows_after_a_gap_are_after_it_however_old_they_are(late_s: float) -> None:
    """400 rows whose temperature is lost, in which the film turned round, and readings of up to seven rows before."""
    _, v, _ = with_an_excursion(None)
    there_and_back = np.concatenate((np.linspace(v[GAP - 1], 86.0, 201)[1:], np.linspace(86.0, v[GAP - 1], 201)[1:]))
    whole = np.concatenate((v[:GAP], there_and_back, v[GAP:]))
    time, lost = 0.5 * np.arange(whole.size), whole.copy()
    lost[GAP : GAP + 400] = np.nan
    record = prepare(FilmRecord(time, lost, np.sin(0.01 * time), output_time_s=time + late_s))
    (row,) = record.unseen
    assert record.gap_s.tolist() == [time[GAP + 400] - time[GAP - 1]]
    assert record.origin is not None
    readings = np.flatnonzero(record.used)
    assert np.all(record.origin[readings[readings < row]] < GAP)
    assert np.all(record.origin[readings[readings >= row]] >= GAP + 400)


def test_rows_after_a_gap_that_have_no_temperature_are_of_the_same_gap() -> None:
    time, v, y = with_an_excursion(None)
    lost = v.copy()
    lost[GAP : GAP + 20] = np.nan
    record = prepare(FilmRecord(time, lost, y))
    assert record.gaps.tolist() == record.unseen.tolist() == [GAP + 20]
    assert record.gap_s.tolist() == [time[GAP + 20] - time[GAP - 1]]


def test_where_the_film_went_stands_in_its_path_and_in_no_reading() -> None:
    time, v, y = with_an_excursion(None)
    record = prepare(FilmRecord(time, v, y, output_time_s=time + 0.1), noise_K=0.0)
    row = record.unseen[0]
    start = FilmStart("cooled", (), ((float(record.time_s[row]), (20.0, 95.0)),))
    few = np.zeros(record.used.size, dtype=np.bool_)
    few[::17] = True
    for chosen in (None, [few]):
        path = build_path([record], [start], chosen)
        plain = build_path([record], [FilmStart("cooled")], chosen)
        at = int(np.flatnonzero(path.inputs == 20.0)[0])
        assert path.inputs[at - 1 : at + 3].tolist() == [record.inputs[row - 1], 20.0, 95.0, record.inputs[row]]
        np.testing.assert_array_equal(path.inputs[path.rows], plain.inputs[plain.rows])
        np.testing.assert_array_equal(path.sample, plain.sample)


def test_each_record_has_gaps_of_its_own() -> None:
    hot, cold = with_an_excursion(86.0), with_an_excursion(38.0)
    records = [FilmRecord(*hot, "hot"), FilmRecord(*cold, "cold")]
    fit = identify_film_records(records, kind="extended_generalized_pi", form="tanh")
    assert fit.rmse < 1.05 * NOISE
    assert fit.starts[0].passed_degC[0][1][0] > 70.0
    assert fit.starts[1].passed_degC[0][1][0] < 54.0
