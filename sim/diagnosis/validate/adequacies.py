"""What a fit leaves in each channel, over the noise, and whether it is nothing."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.record import Mask, Rows
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.adequacy import Adequacy, adequacy


def temperature_residual(chain: Chain, names: frozenset[str]) -> tuple[Array, Rows]:
    """Residual over noise of the thermometer in the fitted rows, and the rows."""
    a, _ = chain.fits(names)
    assert a is not None
    assert chain.first is not None
    return chain.first.channel.residual(a), chain.first.channel.rows


def resistance_residual(chain: Chain, names: frozenset[str]) -> tuple[Array, Rows]:
    """Residual over noise of the ohmmeter in the fitted rows, and the rows."""
    _, b = chain.fits(names)
    assert b is not None
    channel = chain.film_channel(names)
    return channel.residual(b), channel.rows


def adequacies(chain: Chain, names: frozenset[str]) -> tuple[Adequacy | None, Adequacy | None]:
    """What the fit with these effects leaves in each channel."""
    temperature = resistance = None
    if chain.first is not None:
        z, rows = temperature_residual(chain, names)
        temperature = of_temperature(chain, names, z, rows, chain.first.channel.noise)
    if chain.record.output is not None:
        assert chain.facts is not None
        z, rows = resistance_residual(chain, names)
        resistance = of_resistance(chain, names, z, rows, chain.facts.noise)
    return temperature, resistance


def of_temperature(chain: Chain, names: frozenset[str], z: Array, rows: Rows, noise: NoiseModel) -> Adequacy:
    """Whether z is nothing: what the fit leaves in these rows of the thermometer, over this noise."""
    record, fit = chain.record, chain.fits(names)[0]
    assert fit is not None
    state = {} if record.current_A is None else {"current": record.current_A[np.maximum(rows - 1, 0)]}
    return adequacy(z, record.time_s[rows], fit.shown_degC[rows], state, _without_lines(noise, rows))


def of_resistance(chain: Chain, names: frozenset[str], z: Array, rows: Rows, noise: NoiseModel) -> Adequacy:
    """The same of the ohmmeter."""
    record, fit = chain.record, chain.fits(names)[1]
    assert fit is not None
    state = {} if record.test_current_A is None else {"test current": record.test_current_A[rows]}
    if chain.facts is not None and chain.facts.domains is not None:  # what is left hangs on where they switch
        still = chain.facts.domains.stands(rows, fit.shown[rows])
        return adequacy(z, record.time_s[rows], None, state, still)
    state["resistance"] = fit.shown[rows]
    temperature = chain.film_channel(names).path.at(record.time_s[rows])
    return adequacy(z, record.time_s[rows], temperature, state, _without_lines(noise, rows))


def _without_lines(noise: NoiseModel, rows: Rows) -> Mask | None:
    """All rows, where the noise has a colour: its spectrum is smooth, and a line in it is no noise."""
    return None if noise.colour is None else np.ones(rows.size, dtype=np.bool_)
