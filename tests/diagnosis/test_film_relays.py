"""A film of another kind inside the chain: its relays are heated, crept, shunted and lagged as the rest of the film."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE
from sim.diagnosis.fit.film_point import Point
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters
from sim.diagnosis.report.detectability import hidden_by_the_film
from sim.diagnosis.report.upper_limits import upper_limits
from sim.diagnosis.report.warnings import film_is_not_described
from sim.diagnosis.search.chain import Chain, temperature_search
from sim.diagnosis.search.learned import with_film
from sim.diagnosis.search.resistance_search import RELAY_STEPS, WHOLE_STEPS
from sim.diagnosis.search.temperature_search import held_effect
from sim.diagnosis.search.views import View
from sim.effects.catalogue import catalogue
from sim.effects.effect import Switched, switched
from tests.diagnosis.cases import case
from tests.diagnosis.truth.draw import draw_film
from tests.diagnosis.truth.films import Film

RELAYS_DEC = 0.1
EFFECTS = {
    "film_lag": {"tau_s": 2.0},
    "film_drift": {"drift_K_per_h": 3.0},
    "self_heating": {"theta_K_per_W": 500.0},
    "creep": {"share": 0.1, "tau_s": 200.0},
    "meter_lag": {"tau_s": 2.0},
    "timestamp_skew": {"skew_s": 1.3},
    "series_resistance": {"series_ohm": 100.0},
    "parallel_leakage": {"leakage_ohm": 5e5},
    "meter_range_error": {"threshold_ohm": 1e4, "error": 0.02},
}


@pytest.fixture(scope="module")
def chain() -> Chain:
    record = read_columns(case("other_film", 3, film="preisach").columns, held_out=True)
    effects = dict(catalogue())
    chain = Chain(record, effects, temperature_search(record, effects))
    return with_film(chain, frozenset())


def solved(
    channel: ResistanceChannel, base: FilmParameters, *names: str, mixing: tuple[float, float, float] | None = None
) -> tuple[FilmParameters, Point]:
    """The best coefficients beside these effects, with relays. mixing: change, exponent, percolation."""
    known = catalogue()
    p = channel.extended(base.with_relays(RELAYS_DEC), [switched(known[n], EFFECTS[n]) for n in names])
    if mixing is not None:
        p = replace(p, mixes=True)
        p.x[ENVELOPES:SHAPE] = mixing
    point = channel.point(p, p.x)
    for _ in range(4):
        point = channel.point(p, p.x, point.coefficients)
    return p, point


@pytest.mark.parametrize("mixing", [None, (0.2, -0.3, 0.3)])
@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_solved_for_is_what_is_predicted(
    chain: Chain, name: str, mixing: tuple[float, float, float] | None
) -> None:
    search = chain.last(frozenset())
    p, point = solved(search.channel, search.base, name, mixing=mixing)
    np.testing.assert_allclose(search.channel.predict(p, p.x, point), point.shown, atol=2e-5, rtol=0.0)
    without = point.problem.relays.film @ point.coefficients[-point.problem.relays.count :]
    assert np.std(without) > 1e-3  # the relays do something


def test_the_terminals_see_all_of_the_film(chain: Chain) -> None:
    search = chain.last(frozenset())
    _, point = solved(search.channel, search.base, "parallel_leakage")
    ohm = 10.0**-point.unmixed
    expected = np.log10(1.0 / ohm + 1.0 / EFFECTS["parallel_leakage"]["leakage_ohm"])
    np.testing.assert_allclose(point.shown, expected, atol=2e-5, rtol=0.0)


def test_relays_move_with_the_film(chain: Chain) -> None:
    """Predicted a step away, the relays are where the film then is."""
    search = chain.last(frozenset())
    p, point = solved(search.channel, search.base, "film_drift")
    moved = p.x.copy()
    moved[SHAPE] += 1.0
    there = search.channel.predict(p, moved, point)
    _, nodes = search.channel.nodes(p, moved)
    c = point.coefficients
    relays = search.channel.basis.plane.columns(nodes) @ c[c.size - search.channel.relay_count(p) :]
    none = replace(point, coefficients=np.where(np.arange(c.size) < search.channel.basis.columns, c, 0.0))
    np.testing.assert_allclose(there - search.channel.predict(p, moved, none), relays, atol=2e-5, rtol=0.0)


def test_a_noisier_record_hides_more() -> None:
    columns = case("clean", 3).columns
    noise = 10.0 ** np.random.default_rng(1).normal(0.0, 0.02, columns["time_s"].size)
    noisy = {**columns, "resistance_ohm": columns["resistance_ohm"] * noise}
    hidden = []
    for each in (columns, noisy):
        record = read_columns(each, held_out=True)
        chain = with_film(Chain(record, dict(catalogue())), frozenset())
        hidden.append(hidden_by_the_film(chain, frozenset()))
    quiet, loud = (each["series_resistance"] for each in hidden)
    assert quiet[0] == loud[0] == "series_ohm"
    assert 10.0 < quiet[1] < 500.0  # of a metallic film of 3,500 ohm
    assert np.isnan(loud[1]) or loud[1] > 1.5 * quiet[1]


@pytest.mark.long
def test_a_size_beside_relays_is_that_of_the_largest_marginal_likelihood() -> None:
    """Of the penalized cost alone it would be 108 ohm, of 273. The film's phases are held to mix in their logarithms,
    as they do: what another mixing does is much like what leads in series do."""
    blind = case("other_film_effect", 10500)
    record = read_columns(blind.columns, held_out=True)
    effects = dict(catalogue())
    chain = with_film(Chain(record, effects, temperature_search(record, effects)), frozenset())
    search = chain.last(frozenset())
    bare = replace(search.fit(frozenset()).parameters, mixes=False)
    leads = switched(catalogue()["series_resistance"], [200.0])
    without, fit = (search.channel.descend(search.channel.extended(bare, on), WHOLE_STEPS) for on in ([], [leads]))
    without, fit = (search.channel.descend(f.parameters, WHOLE_STEPS) for f in (without, fit))
    assert fit.parameters.has_relays
    (found,) = fit.effects
    assert float(found.par[0]) > 0.5 * blind.hidden["series_resistance"]["series_ohm"]
    for times in (0.6, 1.6):
        held = Switched(held_effect(found.effect), times * found.par)
        other = search.channel.descend(search.channel.extended(fit.parameters, [held]), RELAY_STEPS)
        assert other.score < fit.score - 1.0
    assert fit.score > without.score + 20.0


@pytest.mark.long
def test_a_film_of_the_class_behind_a_coarse_thermometer_needs_no_relays() -> None:
    """Readings in steps of 0.18 K leave the plate's path some millikelvin off, and the film sees them."""
    blind = case("three", 10803)
    record = read_columns(blind.columns, held_out=True)
    effects, names = dict(catalogue()), frozenset({"radiative_loss", "series_resistance"})
    chain = Chain(record, effects, temperature_search(record, effects))
    chain = with_film(chain, chain.split(names)[0])
    apart = chain.score(names)
    assert not chain.fits(names)[1].parameters.has_relays  # type: ignore[union-attr]
    chain = replace(chain, together=True)
    joint = chain.joint(names)
    assert joint is not None
    assert not joint.b.parameters.has_relays
    assert joint.score > apart + 100.0
    for fit in (joint.a, joint.b):
        for effect in fit.effects:
            (truth,) = blind.hidden[effect.name].values()
            assert float(effect.par[0]) == pytest.approx(truth, rel=0.02)


def chain_of(film: Film) -> Chain:
    """A film through turning points all over its loop, 1e-3 decades of noise, the temperature as it is."""
    rng = np.random.default_rng(5)
    turns = np.concatenate(([25.0, 90.0, 30.0, 90.0, 30.0], rng.uniform(45.0, 75.0, 40)))
    legs = [np.linspace(a, b, max(int(abs(b - a) / 0.4), 2), endpoint=False) for a, b in pairwise(turns)]
    temperature = np.concatenate(legs)
    log_ohm = film.log_ohm(temperature) + 1e-3 * rng.standard_normal(temperature.size)
    columns = {
        "time_s": np.arange(temperature.size, dtype=np.float64),
        "temperature_degC": temperature,
        "resistance_ohm": 10.0**log_ohm,
    }
    return with_film(Chain(read_columns(columns, held_out=True), dict(catalogue())), frozenset())


@pytest.mark.parametrize("exponent", [pytest.param(-0.6, marks=pytest.mark.long), 0.5])
def test_how_the_phases_of_a_film_mix_is_found(exponent: float) -> None:
    """By a fit that is weighed by the noise of a film of the class, before the record's own is known."""
    film = draw_film(np.random.default_rng(8), "mixed", form=0)
    table = film.table.copy()
    table[2] += 60.0 - np.mean(table[2])
    table[4] = exponent
    chain = chain_of(replace(film, table=table))
    search = chain.last(frozenset())
    fit = search.fit(frozenset())
    assert fit.parameters.is_mixed
    # 0.33 is the best that this film's record has for 0.5, from six starts: the percolation makes up for the rest
    assert fit.parameters.x[ENVELOPES + 1] == pytest.approx(exponent, abs=0.3)
    unmixed = search.channel.descend(replace(fit.parameters, mixes=False), WHOLE_STEPS)
    assert fit.score > unmixed.score + 20.0


@pytest.mark.long
@pytest.mark.parametrize("dimensions", [2.0, 3.0])
def test_the_medium_in_which_a_film_s_metal_percolates_is_found(dimensions: float) -> None:
    """From the first fit on, whatever is left without it: exponent 2 / d - 1, of steepness 1."""
    film = draw_film(np.random.default_rng(8), "medium", form=0)
    table = film.table.copy()
    table[2] += 60.0 - np.mean(table[2])
    table[4] = dimensions
    fit = chain_of(replace(film, table=table)).last(frozenset()).fit(frozenset())
    _, exponent, percolation = fit.parameters.x[ENVELOPES:SHAPE]
    assert exponent == pytest.approx(2.0 / dimensions - 1.0, abs=0.05)
    assert np.sqrt(exponent**2 + percolation) == pytest.approx(1.0, abs=0.03)


def test_a_film_whose_logarithms_add_needs_no_mixing() -> None:
    film = draw_film(np.random.default_rng(8), "preisach", form=0)
    table = film.table.copy()
    table[2] += 60.0 - np.mean(table[2])
    fit = chain_of(replace(film, table=table)).last(frozenset()).fit(frozenset())
    assert fit.parameters.has_relays
    assert not fit.parameters.is_mixed


def test_a_trial_of_a_mixing_at_its_bounds_has_a_cost_that_falls(chain: Chain) -> None:
    """Of a film that mixes otherwise: what is far from linear is solved for on a way on which the cost falls, and what
    is shown is what is predicted."""
    channel, (_, fit) = chain.film_channel(frozenset()), chain.fits(frozenset())
    assert fit is not None
    least = channel.point(fit.parameters, fit.parameters.x, fit.coefficients).cost
    p = replace(channel.extended(fit.parameters.with_relays(1.0), []), mixes=True)
    p.x[ENVELOPES:SHAPE] = (0.8, -1.5, 2.25)
    point = channel.point(p, p.x)
    for _ in range(3):
        again = channel.point(p, p.x, point.coefficients)
        assert 2.0 * least < again.cost <= point.cost
        np.testing.assert_allclose(channel.predict(p, p.x, again), again.shown, atol=1e-9)
        point = again


def test_what_an_effect_changes_begins_at_nothing(chain: Chain) -> None:
    """Beside a range's error, where a fit takes the ranges from the readings and a prediction from what it shows: what
    the two differ by is no effect's. A tenth of a lag changes a tenth of what the lag does."""
    channel, (_, fit) = chain.film_channel(frozenset()), chain.fits(frozenset())
    assert fit is not None
    far = switched(catalogue()["meter_range_error"], {"threshold_ohm": 1e4, "error": 0.1})  # no range has this error
    view, lag = View(channel, channel.descend(channel.extended(fit.parameters, [far]), 0)), catalogue()["film_lag"]
    more, less = (float(np.linalg.norm(view.left_of(switched(lag, {"tau_s": tau_s})))) for tau_s in (1e-2, 1e-3))
    assert less == pytest.approx(0.1 * more, rel=0.1)


def test_no_limit_is_given_beside_a_film_that_is_not_described(chain: Chain, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left of such a film is no noise, and excludes nothing. Here the bound is drawn below the noise itself."""
    assert not film_is_not_described(chain, frozenset())
    monkeypatch.setattr("sim.diagnosis.report.upper_limits.TOO_MUCH_LEFT", 0.1)
    limits = {limit.name: limit.limit for limit in upper_limits(chain, frozenset(), {})}
    assert limits["film_lag"] is None
    assert limits["series_resistance"] is None
    assert limits["sensor_lag"] is not None
    (warning,) = film_is_not_described(chain, frozenset())
    assert "interval" not in warning.text  # nothing is named
