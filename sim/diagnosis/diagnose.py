"""From a record to a diagnosis: what the simulation gets wrong, why, and what the repair gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from sim.diagnosis.data.joined import read_records
from sim.diagnosis.data.quantity import FALLING_OHM, Quantity
from sim.diagnosis.data.record import Record, read_columns
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.in_its_unit import in_its_unit
from sim.diagnosis.judge.alike_delays import simplest_of_alike
from sim.diagnosis.judge.carried_over import CarriedOver, carried_over
from sim.diagnosis.judge.coloured_noise import beside_coloured_noise
from sim.diagnosis.judge.domains import beside_domains
from sim.diagnosis.judge.elsewhere import borne_out
from sim.diagnosis.judge.false_alarm import LARGEST, SMALLEST, candidates, false_alarm
from sim.diagnosis.judge.film_records import told_by_film_records
from sim.diagnosis.judge.smoothed_path import on_a_smoothed_path
from sim.diagnosis.judge.turns_between import TURNS, only_turns
from sim.diagnosis.judge.verdict import UNSEEN, Verdict, judge
from sim.diagnosis.report.candidates import candidates_of
from sim.diagnosis.report.confounders import confounders_of
from sim.diagnosis.report.detectability import hidden_by_the_film
from sim.diagnosis.report.film_kind import film_kind
from sim.diagnosis.report.intervals import intervals, vague_effects
from sim.diagnosis.report.next_experiment import next_experiments
from sim.diagnosis.report.plate_numbers import plate_numbers
from sim.diagnosis.report.upper_limits import upper_limits
from sim.diagnosis.report.warnings import (
    decided_by_records,
    decided_elsewhere,
    left_open,
    out_of_time,
    unlogged_currents,
    warnings_of,
)
from sim.diagnosis.result import ONLY_UNSEEN, Channel, Diagnosis, Finding, verdict_of
from sim.diagnosis.search.both_ends import select
from sim.diagnosis.search.budget import JUDGING, SEARCHING, Budget, stopped
from sim.diagnosis.search.chain import FALSE_ALARM, Chain, rounds
from sim.diagnosis.search.either_kind import is_open, search_of_either_kind
from sim.diagnosis.validate.adequacies import resistance_residual, temperature_residual
from sim.diagnosis.validate.adequacy import describe
from sim.diagnosis.validate.gain import gain, rmse
from sim.diagnosis.validate.held_out_rows import HeldOutRows, Other
from sim.diagnosis.without_memoryless import without_memoryless
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect, pinned
from sim.inference.nuisance import told_rows

Progress = Callable[[str], None]
QUANTIZATION = "thermometer_quantization"
SHOWN = 0.002  # of a channel's error: an effect that changes less of it does not show there


def diagnose(
    columns: Mapping[str, ArrayLike],
    *further: Mapping[str, ArrayLike],
    base: str | None = None,
    output: str = FALLING_OHM,
    holdout: Sequence[Mapping[str, ArrayLike]] = (),
    of_film: Sequence[Mapping[str, ArrayLike]] = (),
    as_predicted: bool = False,
    effects: dict[str, Effect] | None = None,
    kinds: tuple[str, ...] = ("peltier",),
    assume: Mapping[str, Mapping[str, float]] | None = None,
    budget_s: float | None = None,
    chosen_false_alarm: float = FALSE_ALARM,
    clock: Callable[[], float] = stopped,
    say: Progress = lambda text: None,
) -> Diagnosis:
    """Diagnose one record (columns as in a record file: names with units), or several of one rig as one.

    base: "generalized_pi" restricts the film to no D(T), unless `memoryless_term` is named. output: the film's, rising
    with temperature: "log10_ohm" where a resistance rises, else a column, or "minus_" and a column. holdout: other
    records of the same rig, on which the gain is measured; without any every fourth block of rows is held out. of_film:
    others of the same film, which decide what this one leaves open of it. as_predicted: what belongs to another record
    (room, first temperatures, memory) is fitted to its first rows alone, as whoever predicts it would have to; else to
    all, so that what remains is the model's fault. assume: effects that are there, whatever the record says, and of
    each the parameters that are known, by name; the others are fitted. budget_s: how long it may take, on the clock (s,
    one that goes): what was found by then is judged and reported, with a warning. chosen_false_alarm: the share of
    records with nothing in them that may be given a name. Raises ValueError, a line a fault, where nothing can be said.
    """
    if budget_s is not None and clock is stopped:
        raise ValueError("budget_s: needs a clock; expected clock=time.monotonic beside it")
    if not SMALLEST <= chosen_false_alarm <= LARGEST:
        raise ValueError(f"false alarm {chosen_false_alarm:g}: expected {SMALLEST:g} to {LARGEST:g}")
    began_s = clock()
    with threadpool_limits(limits=1):
        record = read_records((columns, *further), output, held_out=not holdout)
        known = (quantity := record.quantity).effects(catalogue() if effects is None else effects)
        budget = Budget(math.inf if budget_s is None else budget_s, clock, began_s)
        chain = _chain(record, known, kinds, assume or {}, budget)
        undecided = chain.first is not None and budget.over(SEARCHING) and is_open(chain.first, kinds)
        chain, names = select(begun := replace(chain, false_alarm=chosen_false_alarm), say)
        cut = ("the search", SEARCHING) if budget.over(SEARCHING) else None
        say("evidence")
        chain, judged = _judged(begun, chain, names, say)
        judged = told_by_film_records(chain, judged, _further(of_film, quantity))
        judged = _with_sizes(chain, simplest_of_alike(chain, judged))
        others = [other.commanded_in_sight(known.values()) for other in _further(holdout, quantity)]
        told = borne_out(chain, judged, others)
        first = tuple(Other(o, told_rows(o) if as_predicted else None) for o in others)
        held_out = HeldOutRows(chain, first, told.halves)
        cut = cut or (("the judging of what was found", JUDGING) if budget.over(JUDGING) else None)
        found = _diagnosis(chain, told.judged, held_out, say)
        if cut is not None:
            warning = out_of_time(*cut, budget.seconds, kinds if undecided else ())
            found = replace(found, warnings=[*found.warnings, warning])
        if base == "generalized_pi":
            found = without_memoryless(found, held_out, budget.over())
        return in_its_unit(found)


def _judged(begun: Chain, chain: Chain, names: frozenset[str], say: Progress) -> tuple[Chain, Verdict]:
    """What may be said, beside what else may be the cause of what is left: steps of the film's domains, noise of
    another colour, a smoother path. What a film leaves in steps often passes for noise of another colour, and a search
    beside that takes as long as the first: where the plate is understood, domains are asked for before."""
    first = judge(chain, names)
    understood = first.temperature is None or first.temperature.clean
    if understood:
        stepped, judged = beside_domains(chain, names, first, say)
        if judged is not first:
            return stepped, judged
    chain, names, judged = beside_coloured_noise(begun, (chain, names, first), say)
    chain, judged = on_a_smoothed_path(chain, names, judged)
    if understood and judged is first:  # asked before
        return chain, judged
    return beside_domains(chain, names, judged, say)


def _with_sizes(chain: Chain, judged: Verdict) -> Verdict:
    """Without names whose size the record does not fix."""
    while vague := set(vague_effects(chain, judged.fitted)) - chain.assumed:
        weakest = min(sorted(vague), key=judged.evidence.__getitem__)
        judged = judge(chain, judged.fitted - {weakest}, judged, "the record does not fix its size")
    return judged


def _further(records: Sequence[Mapping[str, ArrayLike]], quantity: Quantity) -> list[Record]:
    """Read as the diagnosed one is, and nothing of them held out."""
    return [read_columns(one, held_out=False, quantity=quantity) for one in records]


def _chain(
    record: Record,
    known: dict[str, Effect],
    kinds: tuple[str, ...],
    assume: Mapping[str, Mapping[str, float]],
    budget: Budget,
) -> Chain:
    """What is searched on this record. Raises ValueError."""
    record = record.read_while_it_ran(known.values()).commanded_in_sight(known.values())
    known, assumed = _assumed(known, assume, record)
    first, as_read = None, record
    if record.current_A is not None:
        first = search_of_either_kind(record, known, kinds, assumed, budget)
        record = first.channel.record
        as_read = replace(as_read, early=record.early)
    elif record.output is None:
        raise ValueError(f"record: neither current_A nor {record.quantity.column}; expected at least one of them")
    return Chain(record, known, first, assumed=assumed, budget=budget, as_read=as_read)


def _assumed(
    known: dict[str, Effect], assume: Mapping[str, Mapping[str, float]], record: Record
) -> tuple[dict[str, Effect], frozenset[str]]:
    """All effects, those assumed with the parameters that are known; the names of those assumed. Raises ValueError for
    one that the record cannot have."""
    lines = []
    for name in assume:
        effect = known.get(name)
        if effect is None:
            lines.append(f"{name}: no effect of this record's film; expected one of {', '.join(known)}")
        elif effect.before_film and record.current_A is None:
            lines.append(f"{name}: current_A: missing; an effect on the {effect.link} needs it")
        elif not effect.before_film and record.output is None:
            lines.append(f"{name}: {record.quantity.column}: missing; an effect on the {effect.link} needs it")
        elif getattr(effect.form, "heated", False) and record.test_current_A is None:
            lines.append(f"{name}: meter_current_A: missing; the heat of the test current needs it")
        elif rounds(effect):
            lines.append(f"{name}: is seen in the readings, and needs no assumption")
    if lines:
        raise ValueError("\n".join(lines))
    return {**known, **{name: pinned(known[name], values) for name, values in assume.items()}}, frozenset(assume)


def _diagnosis(chain: Chain, judged: Verdict, held_out: HeldOutRows, say: Progress) -> Diagnosis:
    record, names = chain.record, judged.fitted
    say("gain")
    lattice = _lattice(chain)
    held_out = replace(held_out, on_lattice=lattice is not None)
    noise = held_out.noise(names)
    carried = carried_over(held_out, names)
    channels = _channels(held_out, names, noise, carried)
    say("candidates")
    candidates = candidates_of(chain, judged, held_out.left, held_out.parts, held_out.rows, noise)
    say("intervals")
    confounders = confounders_of(chain, names, judged)
    findings = _findings(chain, judged, held_out, confounders)
    if lattice is not None:
        smooth, shown = held_out.residuals(names), held_out.left(names)
        gains = {c: gain(smooth[c], shown[c], held_out.rows) for c in smooth if c == "temperature_K"}
        findings = sorted([*findings, replace(lattice, gain=gains)], key=lambda f: -f.evidence)
    unexplained = _unexplained(chain, judged, channels, carried.times)
    next_experiment = next_experiments(
        chain.effects,
        [f.name for f in findings],
        confounders,
        [text for text in unexplained.values() if text is not None],
        record.current_A is not None,
        record.test_current_A is not None or record.output is None or not record.quantity.is_resistance,
        record.early == 0.0,
        record.output is not None,
    )
    if turns := only_turns(chain, names, unexplained):
        unexplained["resistance_dec"] = TURNS
    verdict = verdict_of(findings, unexplained, chain.sparse is not None or turns)
    hidden = hidden_by_the_film(chain, names)
    limits = upper_limits(chain, names, hidden)
    if verdict == "too_short" and chain.sparse is not None:
        next_experiment = [f"record {chain.sparse.missing}", *next_experiment]
    return Diagnosis(
        verdict,
        findings,
        channels,
        unexplained,
        film_kind(chain, names),
        [
            *warnings_of(chain, names, hidden, limits),
            *unlogged_currents(record),
            *left_open(carried),
            *decided_elsewhere(held_out.halves),
            *decided_by_records(judged.by_records & judged.fitted),
        ],
        next_experiment,
        record,
        chain,
        judged,
        plate_numbers(chain, names),
        candidates,
        limits,
        {name: values for name, values in intervals(chain, names).items() if name in chain.assumed},
        _rooms_degC(chain, names),
        held_out.halves,
    )


def _rooms_degC(chain: Chain, names: frozenset[str]) -> list[float]:
    """Each record's room; none without a current."""
    fit = chain.fits(names)[0]
    if fit is None:
        return []
    room = float(fit.parameters.plate()[-1])
    return [room, *(room + fit.parameters.rooms_K).tolist()]


def _channels(
    held_out: HeldOutRows, names: frozenset[str], noise: dict[str, float], carried: CarriedOver
) -> dict[str, Channel | None]:
    """Of the base model, which has the effects assumed and stays as if no reading were rounded, and of the extended
    one."""
    channels: dict[str, Channel | None] = {"temperature_K": None, "resistance_dec": None}
    bare = held_out.residuals(held_out.chain.assumed)
    for name, residual in held_out.left(names).items():
        counted = held_out.rows & np.isfinite(residual)
        before, after = rmse(bare[name][counted]), rmse(residual[counted])
        channels[name] = Channel(
            noise[name], before, after, int(np.sum(counted)), carried.expected[name], carried.times[name]
        )
    return channels


def _findings(
    chain: Chain, judged: Verdict, held_out: HeldOutRows, confounders: Mapping[str, list[str]]
) -> list[Finding]:
    """What is named, with sizes and gains, in order of evidence."""
    names, findings = judged.fitted, []
    parameters, whole = intervals(chain, names), held_out.left(names)
    for name in judged.names:
        rest = held_out.left(names - {name})
        gains = {c: gain(rest[c], whole[c], held_out.rows) for c in whole}
        gains = {c: g for c, g in gains.items() if abs(g.rmse_before - g.rmse_after) > SHOWN * g.rmse_before}
        evidence = judged.evidence[name]
        chance = _false_alarm(chain, evidence)
        findings.append(Finding(name, parameters[name], evidence, chance, confounders.get(name, []), gains))
    return findings


def _unexplained(
    chain: Chain, judged: Verdict, channels: Mapping[str, Channel | None], times: Mapping[str, float]
) -> dict[str, str | None]:
    """By channel: what is left in the fitted rows, or that held-out rows are predicted much worse; None: nothing."""
    record, names = chain.record, judged.fitted
    unexplained: dict[str, str | None] = {"temperature_K": None, "resistance_dec": None}
    for channel, adequacy, residual in (
        ("temperature_K", judged.temperature, temperature_residual),
        ("resistance_dec", judged.resistance, resistance_residual),
    ):
        if adequacy is not None and not adequacy.clean:
            z, rows = residual(chain, names)
            unexplained[channel] = describe(z, record, rows, adequacy.left)
    for name, found in channels.items():
        if found is None or unexplained[name] is not None:
            continue
        if times[name] > UNSEEN:
            unexplained[name] = f"{ONLY_UNSEEN} {rough(times[name])} times worse than {found.foreseen}"
    return unexplained


def _lattice(chain: Chain) -> Finding | None:
    """The thermometer's rounding, which the readings show by themselves."""
    record = chain.record
    step = record.step_K
    sigma_K = chain.first.channel.sigma_K if chain.first is not None else 0.0
    noise_K = float(np.hypot(sigma_K, step / np.sqrt(12.0)))  # of an error that is uniform over a step, too
    if step <= 0.0 or step < 0.5 * noise_K:
        return None
    values = record.temperature_degC[record.temperature_used]
    index = np.round(values / step)
    if np.max(np.abs(values - index * step)) < 0.2 * step:  # further off they lie on no lattice through 0
        step = float(index @ values / (index @ index))
    rows = float(values.size)
    evidence = rows * float(np.log(max(step / max(noise_K, 0.02 * step), 2.0)))  # less noise shows in no reading
    apart = float(np.std(values - index * step)) / max(float(np.max(np.abs(index))), 1.0)
    spread = max(1e-6 * step, 4.0 * apart)  # a file's last digit; four deviations, to be sure
    ci = (step - spread, step + spread)
    return Finding(QUANTIZATION, {"step_K": (step, ci)}, evidence, _false_alarm(chain, evidence), [], {})


def _false_alarm(chain: Chain, evidence: float) -> float:
    """How often a record with nothing in it would show so much for some effect."""
    return false_alarm(evidence, candidates(chain.searched))
