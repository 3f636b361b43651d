"""From a record to a diagnosis: what the simulation gets wrong, why, and what the repair gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask, Record, read_columns
from sim.diagnosis.judge.false_alarm import false_alarm
from sim.diagnosis.judge.verdict import (
    UNSEEN,
    Verdict,
    bends_elsewhere,
    judge,
    resistance_residual,
    temperature_residual,
)
from sim.diagnosis.report.confounders import rivals_of
from sim.diagnosis.report.intervals import intervals, vague_effects
from sim.diagnosis.report.next_experiment import next_experiments
from sim.diagnosis.report.warnings import warnings_of
from sim.diagnosis.result import Channel, Diagnosis, Finding, verdict_of
from sim.diagnosis.search.chain import Chain, temperature_search
from sim.diagnosis.search.stepwise import ABSORBS, select
from sim.diagnosis.validate.adequacy import describe
from sim.diagnosis.validate.gain import gain, rmse
from sim.diagnosis.validate.held_out import residuals_on
from sim.diagnosis.validate.residuals import residuals, rounded
from sim.effects import memoryless_term
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from sim.model.own_fit import told_rows

Progress = Callable[[str], None]
QUANTIZATION = "thermometer_quantization"


def diagnose(
    columns: Mapping[str, ArrayLike],
    *,
    base: str | None = None,
    holdout: Mapping[str, ArrayLike] | None = None,
    effects: dict[str, Effect] | None = None,
    kinds: tuple[str, ...] = ("peltier",),
    say: Progress = lambda text: None,
) -> Diagnosis:
    """Diagnose one record (columns as in a record file: names with units).

    base: "generalized_pi" restricts the film to no D(T). holdout: another record of the same rig, on which the gain is
    measured; without it every fourth block of rows is held out. Raises ValueError, a line a fault, where nothing can be
    said.
    """
    with threadpool_limits(limits=1):
        record = read_columns(columns, held_out=holdout is None)
        known = dict(effects if effects is not None else catalogue())
        record = record.read_while_it_ran(known.values()).commanded_in_sight(known.values())
        chain = Chain(record, ~record.held_out, known)
        if record.current_A is not None:
            chain.first = temperature_search(record, ~record.held_out, known, kinds)
            chain.record = chain.first.channel.record
        elif record.output is None:
            raise ValueError("record: neither current_A nor resistance_ohm; expected at least one of them")
        names = select(chain, say)
        say("evidence")
        judged = judge(chain, names)
        while vague := vague_effects(chain, frozenset(judged.names)):
            weakest = min(vague, key=lambda name: judged.evidence[name])
            judged = judge(chain, frozenset(judged.names) - {weakest})
        other = None
        if holdout is not None:
            other = read_columns(holdout, held_out=False).commanded_in_sight(known.values())
            if bends := bends_elsewhere(chain, frozenset(judged.names), other):
                judged = judge(chain, frozenset(judged.names) - bends)
        found = _diagnosis(chain, judged, other, say)
        if base == "generalized_pi" and record.output is not None:
            found = _restricted(found, other)
        return found


def _restricted(found: Diagnosis, holdout: Record | None) -> Diagnosis:
    """What a base film without D(T) lacks, named as an effect of its own."""
    chain, names = found.chain, frozenset(found.judged.names)
    b = chain.fits(names)[1]
    if b is None or chain.facts is None or chain.facts.basis.curve is None:
        return found
    plain = Chain(chain.record, chain.fitted, chain.effects, relays=False, first=chain.first)
    of_the_class = chain.score(names) - plain.score(names) < ABSORBS  # then nothing but D may stand in for what D does
    bare = Chain(chain.record, chain.fitted, chain.effects, curve=False, relays=not of_the_class, first=chain.first)
    evidence = (plain if of_the_class else chain).score(names) - bare.score(names)
    if evidence < ABSORBS:
        return found
    curve = chain.facts.basis.curve
    path = chain.film_channel(names).path
    range_degC = np.linspace(float(np.min(path.plate_degC)), float(np.max(path.plate_degC)), 200)
    span = float(np.ptp(curve.columns(range_degC) @ b.coefficients[1 : 1 + curve.count]))
    before, after = (_unrounded(c, names, holdout)["resistance_dec"] for c in (bare, chain))
    gains = {"resistance_dec": gain(before, after, _unseen_rows(chain, holdout))}
    term = Finding(memoryless_term.NAME, {"span_dec": (span, None)}, evidence, false_alarm(evidence), [], gains)
    findings = sorted([*found.findings, term], key=lambda f: -f.evidence)
    return replace(found, findings=findings, verdict=verdict_of(findings, found.unexplained))


def _unseen_rows(chain: Chain, holdout: Record | None) -> Mask:
    """The rows that no fit has seen: of another record all."""
    return chain.record.held_out if holdout is None else np.ones(holdout.rows, dtype=np.bool_)


def _unrounded(chain: Chain, names: frozenset[str], holdout: Record | None) -> dict[str, Array]:
    """Residuals in the record's rows, or in another's behind its first ones, as if no reading were rounded."""
    return residuals(chain, names) if holdout is None else residuals_on(chain, names, holdout, told_rows(holdout))


def _diagnosis(chain: Chain, judged: Verdict, holdout: Record | None, say: Progress) -> Diagnosis:
    record, names = chain.record, frozenset(judged.names)
    held = _unseen_rows(chain, holdout)
    say("gain")

    sigma_K = chain.first.channel.sigma_K if chain.first is not None else 0.0
    lattice = _lattice(record, float(np.hypot(sigma_K, record.step_K / np.sqrt(12.0)))) if record.step_K > 0.0 else None
    readings = (record if holdout is None else holdout).temperature_degC

    whole, bare = _unrounded(chain, names, holdout), _unrounded(chain, frozenset(), holdout)
    noise = {"temperature_K": sigma_K}
    on_lattice = lattice is not None and "temperature_K" in whole
    if lattice is not None and on_lattice:
        before = whole["temperature_K"]
        whole["temperature_K"], variance = rounded(readings, before, sigma_K, record.step_K)
        noise["temperature_K"] = float(np.sqrt(np.nanmean(variance[held])))
        lattice = replace(lattice, gain={"temperature_K": gain(before, whole["temperature_K"], held)})
    if chain.facts is not None:
        noise["resistance_dec"] = chain.facts.sigma_dec
    channels: dict[str, Channel | None] = {"temperature_K": None, "resistance_dec": None}
    for name, residual in whole.items():
        counted = held & np.isfinite(residual)
        channels[name] = Channel(noise[name], rmse(bare[name][counted]), rmse(residual[counted]), int(np.sum(counted)))
    say("intervals")
    parameters = intervals(chain, names)
    rivals = rivals_of(chain, names, judged)
    findings = []
    for name in judged.names:
        rest = _unrounded(chain, names - {name}, holdout)
        if on_lattice:
            rest["temperature_K"] = rounded(readings, rest["temperature_K"], sigma_K, record.step_K)[0]
        gains = {c: gain(rest[c], whole[c], held) for c in whole}
        gains = {c: g for c, g in gains.items() if abs(g.rmse_before - g.rmse_after) > 0.002 * g.rmse_before}
        evidence = judged.evidence[name]
        findings.append(Finding(name, parameters[name], evidence, false_alarm(evidence), rivals.get(name, []), gains))
    if lattice is not None:
        findings.append(lattice)
    findings.sort(key=lambda f: -f.evidence)
    unexplained: dict[str, str | None] = {"temperature_K": None, "resistance_dec": None}
    if judged.temperature is not None and not judged.temperature.clean:
        z, rows = temperature_residual(chain, names)
        unexplained["temperature_K"] = describe(
            z, record.time_s[rows], record.temperature_degC[rows], judged.temperature.left
        )
    if judged.resistance is not None and not judged.resistance.clean:
        z, rows = resistance_residual(chain, names)
        unexplained["resistance_dec"] = describe(
            z, record.time_s[rows], record.temperature_degC[rows], judged.resistance.left
        )
    left_over = {name: channel.rmse_extended for name, channel in channels.items() if channel is not None}
    if holdout is not None:  # what first rows leave open of another record's own is no fault of the model
        left_over = _left_over(chain, names, holdout, sigma_K if on_lattice else None)
    for name, channel in channels.items():
        if channel is not None and unexplained[name] is None and left_over[name] > UNSEEN * channel.noise:
            times = left_over[name] / channel.noise
            unexplained[name] = f"rows that no fit has seen are predicted {times:.2g} times worse than the noise"
    left = [text for text in unexplained.values() if text is not None]
    verdict = verdict_of(findings, unexplained)
    film = None
    if chain.facts is not None:
        film = {
            "memoryless": "none" if chain.facts.basis.curve is None else "smooth",
            "operators": int(chain.facts.basis.fractions.size),
            "of_the_class": bool(chain.relays_bring(names) < ABSORBS),
        }
    return Diagnosis(
        verdict,
        findings,
        channels,
        unexplained,
        film,
        warnings_of(chain, names),
        next_experiments(
            chain.effects,
            [f.name for f in findings],
            rivals,
            left,
            record.current_A is not None,
            record.test_current_A is not None or record.output is None,
        ),
        record,
        chain,
        judged,
    )


def _left_over(chain: Chain, names: frozenset[str], other: Record, lattice_noise_K: float | None) -> dict[str, float]:
    """RMSE on another record, what belongs to it fitted to all of its rows. lattice_noise_K: of a thermometer whose
    readings are rounded."""
    left = residuals_on(chain, names, other)
    if lattice_noise_K is not None and "temperature_K" in left:
        step_K = chain.record.step_K
        left["temperature_K"] = rounded(other.temperature_degC, left["temperature_K"], lattice_noise_K, step_K)[0]
    return {name: rmse(values[np.isfinite(values)]) for name, values in left.items()}


def _lattice(record: Record, noise_K: float) -> Finding | None:
    """The thermometer's rounding, which the readings show by themselves."""
    step = record.step_K
    if step < 0.5 * noise_K:
        return None
    values = record.temperature_degC[record.temperature_used]
    index = np.round(values / step)
    step = float(index @ values / (index @ index)) if np.max(np.abs(values - index * step)) < 0.2 * step else step
    rows = float(values.size)
    evidence = rows * float(np.log(max(step / max(noise_K, 0.02 * step), 2.0)))
    spread = max(1e-6 * step, 4.0 * float(np.std(values - index * step)) / max(float(np.max(np.abs(index))), 1.0))
    ci = (step - spread, step + spread)
    return Finding(QUANTIZATION, {"step_K": (step, ci)}, evidence, false_alarm(evidence), [], {})
