"""A film that mixes otherwise than in its logarithms, as a model that others run: its power mean goes with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import read_columns
from sim.diagnosis.extended_model import film_of
from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE
from sim.diagnosis.fit.film_refit import FilmRefit
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.learned import with_film
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


def test_the_extended_model_mixes_as_the_film_does() -> None:
    rng = np.random.default_rng(1)
    turning = [85.0, 40.0, *rng.uniform(48.0, 78.0, 14), 40.0]
    v = np.interp(np.linspace(0.0, len(turning) - 1.0, 3000), np.arange(len(turning)), turning)
    share = metallic_share(v)
    ohm = ((1.0 - share) * INSULATOR_OHM**EXPONENT + share * METAL_OHM**EXPONENT) ** (1.0 / EXPONENT)
    ohm *= 10.0 ** (NOISE_DEC * rng.standard_normal(v.size))
    record = read_columns({"time_s": np.arange(v.size), "temperature_degC": v, "resistance_ohm": ohm})
    effects = dict(catalogue())
    search = with_film(Chain(record, effects, None), frozenset()).last(frozenset())
    p = replace(search.base.with_relays(0.1), mixes=True)
    p.x[ENVELOPES:SHAPE] = 0.0, EXPONENT, 0.0
    errors = {}
    for mixes in (True, False):
        refit = FilmRefit(search.channel, search.channel.descend(replace(p, mixes=mixes)))
        assert (refit.mixing is not None) == mixes
        errors[mixes] = film_of(refit, True)[1]
    assert errors[True] < 1.5 * NOISE_DEC
    assert errors[True] < 0.8 * errors[False]
