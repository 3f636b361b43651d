"""A film that mixes otherwise than in its logarithms, as a model that others run: its power mean goes with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record, read_columns
from sim.diagnosis.extended_model import film_of
from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE
from sim.diagnosis.fit.film_refit import FilmRefit
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.film_mixing import mixed_at_last
from sim.diagnosis.search.learned import with_film
from sim.diagnosis.search.resistance_search import ResistanceSearch
from sim.effects.catalogue import catalogue

EXPONENT, INSULATOR_OHM, METAL_OHM, NOISE_DEC = -0.6, 1e5, 10.0**2.5, 1e-3


def metallic_share(temperature_degC: Array) -> Array:
    """Of 30,000 domains that switch up at 66 and down at 58 degC, more or less, as it is when all were metal before."""
    rng = np.random.default_rng(2)
    middle, half_width = rng.normal(62.0, 2.0, 30000), rng.lognormal(np.log(4.0), 0.3, 30000)
    metal, share = np.ones(30000, dtype=bool), np.empty(temperature_degC.size)
    for k, v in enumerate(temperature_degC):
        metal = (metal | (v > middle + half_width)) & (v >= middle - half_width)
        share[k] = metal.mean()
    return share


def record_of(metal_ohm: float, noise_dec: float) -> Record:
    """Of minor loops."""
    rng = np.random.default_rng(1)
    turning = [85.0, 40.0, *rng.uniform(48.0, 78.0, 14), 40.0]
    v = np.interp(np.linspace(0.0, len(turning) - 1.0, 3000), np.arange(len(turning)), turning)
    share = metallic_share(v)
    ohm = ((1.0 - share) * INSULATOR_OHM**EXPONENT + share * metal_ohm**EXPONENT) ** (1.0 / EXPONENT)
    ohm *= 10.0 ** (noise_dec * rng.standard_normal(v.size))
    return read_columns({"time_s": np.arange(v.size), "temperature_degC": v, "resistance_ohm": ohm})


def search_of(record: Record) -> ResistanceSearch:
    """For what acts on the film and at the ohmmeter."""
    return with_film(Chain(record, dict(catalogue()), None), frozenset()).last(frozenset())


def test_another_mixing_is_tried_at_last_where_much_is_left() -> None:
    """Without it the film leaves more than an effect that is missing would, so that it is not tried on the way."""
    search = search_of(record_of(10.0, 1.2e-3))  # with more noise a sum's rounding decides whether it is tried before
    before = search.fit(frozenset())
    assert search.channel.mean_square(before) > 2.0
    assert not before.parameters.is_mixed
    assert mixed_at_last(search, frozenset()) == frozenset()
    after = search.fit(frozenset())
    assert after.parameters.is_mixed
    assert search.channel.mean_square(after) < 1.3
    assert after.parameters.x[ENVELOPES + 1] == pytest.approx(EXPONENT, abs=0.1)
    assert mixed_at_last(search, frozenset()) is None  # once


def test_a_descent_ends_where_no_step_of_an_unknown_gains() -> None:
    """All columns move with a mixing: with a slope of coefficients that were not the best yet it ended 6 below."""
    search = search_of(record_of(METAL_OHM, NOISE_DEC))
    channel = search.channel
    fit = channel.descend(replace(search.fit(frozenset()).parameters, mixes=True), 24)
    low, high, _ = channel.bounds(fit.parameters)
    for k in range(SHAPE):
        for step in (-0.03, -0.01, 0.01, 0.03):
            x = fit.parameters.x.copy()
            x[k] += step
            if low[k] <= x[k] <= high[k]:
                beside = channel.point(fit.parameters, x, fit.coefficients)
                for _ in range(4):
                    beside = channel.point(fit.parameters, x, beside.coefficients)
                assert beside.evidence < fit.score + 1.0, (k, step)


@pytest.mark.long
def test_the_extended_model_mixes_as_the_film_does() -> None:
    search = search_of(record_of(METAL_OHM, NOISE_DEC))
    p = replace(search.base.with_relays(0.1), mixes=True)
    p.x[ENVELOPES:SHAPE] = 0.0, EXPONENT, 0.0
    errors = {}
    for mixes in (True, False):
        refit = FilmRefit(search.channel, search.channel.descend(replace(p, mixes=mixes)))
        assert (refit.mixing is not None) == mixes
        errors[mixes] = film_of(refit, True)[1]
    assert errors[True] < 1.5 * NOISE_DEC
    assert errors[True] < 0.8 * errors[False]
