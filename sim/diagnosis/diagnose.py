"""From a record to a diagnosis: what the simulation gets wrong, why, and what the repair gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from compensator.hysteresis.functions import Array
from sim.diagnosis.adequacy import describe
from sim.diagnosis.advice import next_experiments
from sim.diagnosis.chain import Chain, temperature_search
from sim.diagnosis.false_alarm import false_alarm
from sim.diagnosis.gain import Gain, gain, rmse
from sim.diagnosis.intervals import intervals, vague_effects
from sim.diagnosis.other_record import residuals_on
from sim.diagnosis.record import Mask, Record, read_columns
from sim.diagnosis.residuals import residuals, rounded
from sim.diagnosis.rivals import rivals_of
from sim.diagnosis.selection import ABSORBS, select
from sim.diagnosis.verdict import UNSEEN, Verdict, bends_elsewhere, judge, resistance_residual, temperature_residual
from sim.diagnosis.warnings import Warning, warnings_of
from sim.effects import memoryless_term
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect

Progress = Callable[[str], None]
QUANTIZATION = "thermometer_quantization"


@dataclass(frozen=True)
class Finding:
    """One named effect: parameters by name with their 95 % intervals, evidence, what it cannot be told from, gain by
    channel."""

    name: str
    parameters: dict[str, tuple[float, tuple[float, float] | None]]
    evidence: float
    false_alarm: float
    indistinguishable_from: list[str]
    gain: dict[str, Gain]


@dataclass(frozen=True)
class Channel:
    """One channel: its noise, the held-out RMSE of the base and of the extended model, and how many rows were held."""

    noise: float
    rmse_base: float
    rmse_extended: float
    samples_holdout: int


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """verdict, findings in order of evidence, channels (None where the record lacks one), what is left in words, the
    film's form, warnings, what to do next; record and chain: for figures and for the extended model."""

    verdict: str
    findings: list[Finding]
    channels: dict[str, Channel | None]
    unexplained: dict[str, str | None]
    film: dict[str, Any] | None
    warnings: list[Warning]
    next_experiment: list[str]
    record: Record
    chain: Chain
    judged: Verdict
    model: str | None = None

    def document(self) -> dict[str, Any]:
        """The JSON of `peltier diagnose`, format peltier-diagnosis/1."""
        return {
            "format": "peltier-diagnosis/1",
            "verdict": self.verdict,
            "effects": [
                {
                    "name": f.name,
                    "parameters": {
                        name: {"value": value, "ci95": list(ci) if ci is not None else None}
                        for name, (value, ci) in f.parameters.items()
                    },
                    "evidence": f.evidence,
                    "false_alarm": f.false_alarm,
                    "indistinguishable_from": f.indistinguishable_from,
                    "gain": {
                        channel: {
                            "rmse_before": g.rmse_before,
                            "rmse_after": g.rmse_after,
                            "reduction_ci95": list(g.reduction_ci95),
                        }
                        for channel, g in f.gain.items()
                    },
                }
                for f in self.findings
            ],
            "channels": {
                name: None
                if c is None
                else {
                    "noise": c.noise,
                    "rmse_base": c.rmse_base,
                    "rmse_extended": c.rmse_extended,
                    "samples_holdout": c.samples_holdout,
                }
                for name, c in self.channels.items()
            },
            "unexplained": self.unexplained,
            "film": self.film,
            "warnings": [w.document() for w in self.warnings],
            "next_experiment": self.next_experiment,
            "model": self.model,
        }


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
    """Residuals in the record's rows, or another's, as if no reading were rounded."""
    return residuals(chain, names) if holdout is None else residuals_on(chain, names, holdout)


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
    for name, channel in channels.items():
        if channel is not None and unexplained[name] is None and channel.rmse_extended > UNSEEN * channel.noise:
            times = channel.rmse_extended / channel.noise
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


def verdict_of(findings: list[Finding], unexplained: dict[str, str | None]) -> str:
    """clean, explained, partly_unexplained or unexplained."""
    left = any(text is not None for text in unexplained.values())
    if findings:
        return "partly_unexplained" if left else "explained"
    return "unexplained" if left else "clean"


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


def with_model(diagnosis: Diagnosis, path: str) -> Diagnosis:
    """The same, with the path of the extended model's file."""
    return replace(diagnosis, model=path)
