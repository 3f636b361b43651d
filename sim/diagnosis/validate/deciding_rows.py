"""The readings that no fit has seen and that decide, and what is left of them over the noise."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Rows
from sim.diagnosis.search.chain import OF_STEP, Chain


def over_noise(chain: Chain, residual: Array, last: bool) -> Array:
    """One channel's residual in the rows that no fit has seen, over the noise; beside what no model explains, in the
    measure of the fitted rows' likelihood."""
    record, rows = chain.record, deciding_rows(chain, last)
    if last:
        assert chain.facts is not None
        assert record.output is not None
        return chain.facts.noise.on(rows, record.output[rows]).over(residual)
    assert chain.first is not None
    channel = chain.first.channel
    residual = residual / np.sqrt(channel.misfit)
    if channel.noise.plain:
        sigma_K = max(channel.sigma_K, OF_STEP * record.step_K)
        return np.asarray(residual / sigma_K, dtype=np.float64)
    return channel.noise.on(rows, record.temperature_degC[rows]).over(residual)


def deciding_rows(chain: Chain, last: bool) -> Rows:
    """The readings of one channel that no fit has seen and that decide."""
    record = chain.record
    return np.flatnonzero(record.deciding & (record.output_used if last else record.temperature_used))
