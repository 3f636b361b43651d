"""Fewer play operators for the same film: a cheaper model, with what it loses.

Operators are taken away one by one, each time the one whose loss the others, with their weights fitted anew, make up
for best. The loss is measured against the whole model over minor loops everywhere in a range of temperatures, not over
the record that the model came from. Every operator that stays keeps its radius and envelopes, and so the order
condition. Compare: J. Zhang et al., ASME DSCC 2013-3969, optimal compression of a generalized PI operator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from compensator.hysteresis.film import Envelope, FilmModel
from compensator.hysteresis.functions import Array
from sim.inference.nnls import solve_triangle

TURNS = 120  # turning points of the probe
ROWS_A_TURN = 40


@dataclass(frozen=True, eq=False)
class Compression:
    """The smaller model, and its error against the whole one in the output's unit: RMS, largest, and the RMS for every
    number of operators that was passed on the way, as (operators, rms)."""

    model: FilmModel
    rms: float
    largest: float
    course: tuple[tuple[int, float], ...]


def probe(low_degC: float, high_degC: float, seed: int = 0) -> Array:
    """Return temperatures (degC) of minor loops everywhere in a range: two major loops, then random turning points."""
    random = np.random.default_rng(seed)
    turns = np.concatenate(([low_degC, high_degC, low_degC, high_degC], random.uniform(low_degC, high_degC, TURNS)))
    parts = [np.linspace(a, b, ROWS_A_TURN, endpoint=False) for a, b in pairwise(turns)]
    return np.concatenate(parts)


def compress(model: FilmModel, operators: int, low_degC: float, high_degC: float, seed: int = 0) -> Compression:
    """Return the best model with at most `operators` of the model's own operators, over low_degC to high_degC.

    Raises ValueError for fewer than one operator.
    """
    if operators < 1:
        raise ValueError(f"operators: {operators}: expected at least 1")
    inputs = probe(low_degC, high_degC, seed)
    memory = model.initial_memory(float(inputs[0]))
    plays = model.play_outputs(inputs, memory)
    whole = plays @ model.weights
    columns = np.column_stack((np.ones(inputs.size), plays, whole))
    triangle = _triangle(columns)
    kept = [int(j) for j in np.flatnonzero(model.weights > 0.0)] or [0]
    weights, square = _fitted(triangle, kept)
    course = [(len(kept), _rms(square, inputs.size))]
    while len(kept) > operators:
        trials = [(_fitted(triangle, [j for j in kept if j != out]), out) for out in kept]
        (weights, square), out = min(trials, key=lambda trial: trial[0][1])
        kept.remove(out)
        course.append((len(kept), _rms(square, inputs.size)))
    error = weights[0] + plays[:, kept] @ weights[1:] - whole
    smaller = replace(
        model,
        radii=model.radii[kept],
        weights=np.maximum(weights[1:], 0.0),
        rising=_chosen(model.rising, kept),
        falling=_chosen(model.falling, kept),
        memoryless=replace(model.memoryless, offset=model.memoryless.offset + float(weights[0])),
    )
    return Compression(smaller, float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error))), tuple(course))


def _triangle(columns: Array) -> Array:
    return np.asarray(np.linalg.qr(columns, mode="r"), dtype=np.float64)


def _chosen(envelopes: Envelope | tuple[Envelope, ...], kept: list[int]) -> Envelope | tuple[Envelope, ...]:
    return tuple(envelopes[j] for j in kept) if isinstance(envelopes, tuple) else envelopes


def _fitted(triangle: Array, kept: list[int]) -> tuple[Array, float]:
    """Return offset and weights >= 0 of the operators kept, and the sum of squares that is left."""
    index = [0, *(j + 1 for j in kept), triangle.shape[1] - 1]
    return solve_triangle(_triangle(triangle[:, index]), 1)


def _rms(square: float, rows: int) -> float:
    return float(np.sqrt(square / rows))
