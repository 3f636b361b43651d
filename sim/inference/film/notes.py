"""Sentences on what records do not determine of a film model, and which profile would determine it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from compensator.hysteresis.film import FilmModel, reversal_jumps
from compensator.hysteresis.functions import Array
from sim.inference.film.preisach_density import slope_density
from sim.inference.film.rows import Prepared
from sim.model.record_own import FilmStart

# at different temperatures inside the transition: at fewer, minor loops between them are extrapolated
ENOUGH_REVERSALS: Final = 5
BEYOND: Final = 0.1  # of the transition's width: by so much a record that crosses it goes on at either end
TRANSITION_PER_HALF_WIDTH: Final = 1.25  # from the central 80 % of the change to nearly all of it


def reversals_inside(records: Sequence[Prepared], low_degC: float, high_degC: float) -> Array:
    """Return distinct temperatures (degC, sorted) between low and high at which the records turn back."""
    found = [record.inputs[record.path.turning[1:-1]] for record in records]
    turning = np.sort(np.concatenate(found))
    turning = turning[(turning > low_degC) & (turning < high_degC)]
    apart = 0.04 * (high_degC - low_degC)
    kept: list[float] = []
    for value in turning:
        if not kept or value - kept[-1] > apart:
            kept.append(float(value))
    return np.array(kept)


def determined_combinations(operators: Array, weights: Array, noise: float) -> int:
    """Return how many combinations of the weights change the output by more than twice the noise when they change by
    the weights' own size. operators: play outputs, shape (readings, operators)."""
    stride = max(1, operators.shape[0] // 2000)
    part = operators[::stride]
    centred = part - part.mean(axis=0)
    square = np.linalg.eigvalsh(centred.T @ centred)
    singular = np.sqrt(np.maximum(square, 0.0) * stride)
    size = float(np.sum(weights)) / weights.size
    return int(np.sum(singular * size > 2.0 * noise))


def memoryless_rms(degC: Array, output: Array) -> float:
    """Return the RMS residual of a model without hysteresis: straight lines over the temperature, one in each bin."""
    order = np.argsort(degC, kind="stable")
    square, count = 0.0, 0
    for part in np.array_split(order, max(2, min(60, degC.size // 6))):
        if part.size > 3:
            away = degC[part] - degC[part].mean()
            degree = 1 if np.ptp(away) > 0 else 0
            left = output[part] - np.polyval(np.polyfit(away, output[part], degree), away)
            square += float(left @ left)
            count += part.size - 2
    return float(np.sqrt(square / max(count, 1)))


def transition(degC: Array, output: Array) -> tuple[float, float]:
    """Return the middle and half-width (degC) of the central 80 % of the output's change per kelvin."""
    edges = np.linspace(np.min(degC), np.max(degC), 61)
    total = np.cumsum(slope_density(degC, output, edges))
    low, high = np.interp([0.1 * total[-1], 0.9 * total[-1]], total, 0.5 * (edges[1:] + edges[:-1]))
    return 0.5 * float(low + high), max(0.5 * float(high - low), float(edges[1] - edges[0]))


def film_notes(
    records: Sequence[Prepared],
    starts: Sequence[FilmStart],
    fresh: Sequence[int],
    readings: tuple[Array, Array, Array],
    plays: Array,
    model: FilmModel,
    parameters: float,
    rmse: float,
) -> tuple[str, ...]:
    """Return sentences, one for each thing that the records do not determine.

    starts: what the film remembers of each record's beginning and gaps; fresh: how many readings of each are none that
    repeat one; readings: degC, output, and 1 or -1 where it rises or falls, (readings,) each; plays: outputs of the
    operators at them, (readings, operators); parameters: number that were fitted.
    """
    notes = []
    weights, (v, output, sense_of) = model.weights, readings
    count, jump = reversal_jumps(model)
    if count:
        notes.append(
            f"{count} of {weights.size} operators violate the order condition: the output jumps by up to {jump:.3g} "
            "where the temperature reverses inside the transition, and the inverse skips that interval."
        )
    low, high = float(np.min(v)), float(np.max(v))
    middle, half = transition(v, output)
    inside = middle - TRANSITION_PER_HALF_WIDTH * half, middle + TRANSITION_PER_HALF_WIDTH * half
    one_way = []
    for sense, word in ((1, "rising"), (-1, "falling")):
        moving = sense_of == sense
        crossed = np.ptp(np.clip(v[moving], *inside)) if np.any(moving) else 0.0
        if crossed < 0.5 * (inside[1] - inside[0]):
            one_way.append(
                f"No {word} sweep through the transition: the {word} envelope is hardly determined. "
                f"Sweep through {inside[0]:.1f} to {inside[1]:.1f} degC in both directions."
            )
    notes += one_way
    if not one_way and memoryless_rms(v, output) < 1.3 * rmse:
        beyond = BEYOND * (inside[1] - inside[0])
        crossed_it = low < inside[0] - beyond and high > inside[1] + beyond
        notes.append(_no_hysteresis(low, high, middle if crossed_it else None))
    else:
        known = determined_combinations(plays, weights, rmse)
        notes += _minor_loops(reversals_inside(records, *inside), inside, bool(one_way), known, weights.size)
    if v.size < 5 * parameters:
        notes.append(
            f"{v.size} readings for {parameters:.0f} fitted numbers: too few to trust the details. "
            f"Record at least {5 * parameters:.0f} readings, most of them inside the transition."
        )
    for record, start, left in zip(records, starts, fresh, strict=True):
        notes += _gaps(record, start) + _repeats(record, left)
    return tuple(notes)


def _gaps(record: Prepared, start: FilmStart) -> list[str]:
    """Return a line on a record's gaps, if it has any: how long, and what was made of the film's memory in them."""
    if not record.gaps.size:
        return []
    count, longest_s = record.gaps.size, float(np.max(record.gap_s))
    longest = "of" if count == 1 else "the longest of"
    seen = f"{record.name}: {count} gap{'s' * (count > 1)} in time, {longest} {longest_s:.3g} s: "
    if not record.unseen.size:
        return [f"{seen}too short for the temperature to have reversed; it is taken as monotone in between."]
    looked = record.longest_unseen.size
    after = "it" if count == 1 else "each" if looked == count else f"the {looked} longest" if looked > 1 else "that one"
    made = f"{seen}the temperature in between is unknown, so the film's memory after {after} is estimated anew"
    if not start.passed_degC:
        return [f"{made}: no excursion shows in the readings that follow."]
    shown = [f"{' and '.join(f'{t:.1f}' for t in degC)} degC before {at:g} s" for at, degC in start.passed_degC]
    return [f"{made}, as if the temperature had gone to {'; to '.join(shown)}."]


def _repeats(record: Prepared, fresh: int) -> list[str]:
    """Return a line on readings that stand in several rows, if any do. fresh: how many are left without them."""
    repeated = record.readings - fresh
    if not repeated:
        return []
    times = 1.0 + repeated / max(fresh, 1)
    return [
        f"{record.name}: each reading of the output stands in {times:.1f} rows on average: its meter is slower than "
        f"the rows. Repeated values count as one reading, in the row in which they come first: {fresh} are left. Read "
        "the meter less often, or shorten its averaging."
    ]


def _no_hysteresis(low: float, high: float, middle: float | None) -> str:
    """Return the line on a film without hysteresis between the ends of a record, degC; middle: of the transition, None
    where it is not seen as a whole."""
    seen = f"No hysteresis larger than the noise is seen between {low:.1f} and {high:.1f} degC"
    if middle is not None:
        return (
            f"{seen}, though the output changes about {middle:.1f} degC and little at either end: the film has none, "
            "or less than this noise shows. Temperature alone determines the output; envelopes and weights are "
            "not determined."
        )
    return (
        f"{seen}: the film has none, or the record does not cross the transition, and neither envelopes nor "
        "weights are determined. Sweep from well below to well above it and back."
    )


def _minor_loops(turned: Array, inside: tuple[float, float], one_way: bool, known: int, weights: int) -> list[str]:
    """Return a sentence if too few reversals lie inside the transition, else nothing.

    turned: temperatures of the reversals, degC; inside: the transition's ends, degC; known: how many combinations of
    the weights the readings determine.
    """
    several = f"reversals at ten or more temperatures between {inside[0]:.1f} and {inside[1]:.1f} degC"
    if turned.size == 0:
        return [
            f"{'One way only' if one_way else 'A major loop only'}: no reversal lies inside the transition "
            f"({inside[0]:.1f} to {inside[1]:.1f} degC), so only the loop's shape determines "
            f"the {weights} weights, and minor loops are not determined. "
            f"Record first-order reversal curves or a decaying oscillation with {several}."
        ]
    if turned.size >= ENOUGH_REVERSALS:
        return []
    where = ", ".join(f"{value:.1f}" for value in turned)
    fixed = f"about {known} combinations of {weights} weights are determined, " if known < weights else ""
    return [
        f"Reversals at {turned.size} temperature{'s' * (turned.size > 1)} only inside the transition "
        f"({where} degC): {fixed}minor loops elsewhere are extrapolated. Record {several}."
    ]
