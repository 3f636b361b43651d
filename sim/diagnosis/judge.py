"""From the likeliest set of effects to a diagnosis: what is named, what is left over, what all of it gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import numpy as np
from scipy.special import chdtrc

from compensator.hysteresis.functions import KELVIN, Array
from sim.diagnosis.intervals import intervals, is_vague
from sim.diagnosis.next_experiment import next_experiments
from sim.diagnosis.plate_numbers import plate_numbers
from sim.diagnosis.result import Candidate, Caution, Channel, Diagnosis, Finding, Sizes, rough, verdict_of
from sim.diagnosis.search import Search, left_over, outweighs
from sim.diagnosis.selection import Selected
from sim.diagnosis.upper_limits import upper_limits
from sim.diagnosis.warnings import warnings_of
from sim.effects.effect import Effect, Reading
from sim.inference.covariance import NORMAL_95
from sim.inference.gain import Gain, gain, rms
from sim.inference.joint.films import PIFilm
from sim.inference.joint.held_out import errors_in
from sim.inference.joint.likelihood import Fit
from sim.inference.record.lattice import step_error
from sim.inference.record.record import Mask, Record

CLOSE: Final = math.log(20.0)  # log-likelihood: a set that is this close is as likely, but for odds of 20
MOST_UNLOGGED: Final = 2.0  # times what unlogged currents make: their mean part of a row is known no better
CLEAN_RECORDS: Final = 300  # no smaller rate than one of so many is stated: what no noise model knows of bounds it
MOST_CANDIDATES: Final = 3  # sets that are shown: more are not read
LEAST_GAIN: Final = 0.02  # of an error, below which a set that is not named is no news
SHOWN: Final = 0.002  # of a channel's error: an effect that changes less of it does not show there
NOT_NAMED_LEFT: Final = "the residual is larger than what this effect explains"
NOT_NAMED_VAGUE: Final = "likely, but the record does not fix its size"
ON_THE_WAY: Final = "fits better, but by less than the price of its parameters"


def judged(
    record: Record,
    chosen: Selected,
    known: Mapping[str, Effect],
    sparse: str | None,
    warnings: Iterable[Caution],
    over: Callable[[], bool],
    say: Callable[[str], None],
) -> Diagnosis:
    """Return the diagnosis of a record for its likeliest set. sparse: what a record lacks that is too short to decide
    about its film; over: the time for a diagnosis has passed."""
    search, base, fit = chosen.search, chosen.base, chosen.fit
    fit, refused = _without_refused(search, fit)
    less = {e.name: search.without(fit, e.name) for e in fit.effects if e.name not in search.assumed}
    all_sizes = intervals(fit)
    if (thermal := fit.by_thermometer) is not fit:
        alone = intervals(thermal)
        all_sizes |= {name: sizes for name, sizes in alone.items() if name in less and not _is_vague(sizes)}
    vague = [name for name in less if _is_vague(all_sizes[name])]
    left = left_over(fit)
    if record.early > 0.0 and fit.metric.temperature.noise.slow < MOST_UNLOGGED * unlogged_K(fit):
        left.pop("temperature", None)  # currents that no row has make as much of it
    say("computing errors in held-out rows")
    before, after = errors_in(base, record.held_out), errors_in(fit, record.held_out)
    rest = {name: errors_in(one, record.held_out) for name, one in less.items() if not over()}
    own = _Units(record)
    findings = []
    for name, without in less.items():
        if name in vague:
            continue
        evidence = search.gain(fit, without)
        gains = own.gains(rest[name], after) if name in rest else {}
        gains = {c: g for c, g in gains.items() if abs(g.rmse_before - g.rmse_after) > SHOWN * g.rmse_before}
        alike = tuple(confounders(fit, name, search))
        chance = _chance(next(e for e in fit.effects if e.name == name), evidence, search)
        findings.append(Finding(name, all_sizes[name], evidence, chance, alike, gains))
    if chosen.memoryless is not None:
        sizes, evidence = chosen.memoryless
        findings.append(Finding("memoryless_term", sizes, evidence, 1.0 / CLEAN_RECORDS))
    if (rounding := _rounding(fit, search)) is not None:
        findings.append(rounding)
    findings.sort(key=lambda f: -f.evidence)
    say("computing upper limits")
    limits = () if over() else tuple(upper_limits(fit, search))
    unexplained = {own.key(c): _in_words(left.get(name), fit, name, own) for c, name in own.channels.items()}
    candidates: tuple[Candidate, ...] = ()
    if not over():
        say("judging candidates")
        likely = [
            _candidate({name: all_sizes[name]}, own.gains(rest[name], after), NOT_NAMED_VAGUE, fit)
            for name in vague
            if name in rest
        ]
        candidates = (*likely, *_candidates(record, search, fit, after, refused, own))
    names = [f.name for f in findings]
    next_experiment = next_experiments(
        known,
        names,
        {f.name: f.indistinguishable_from for f in findings},
        [text for text in unexplained.values() if text is not None],
        record.current_A is not None,
        record.test_current_A is not None or record.output is None or not record.quantity.is_resistance,
        record.early == 0.0,
        record.output is not None,
    )
    every = (*warnings, *warnings_of(record, fit, limits, left, known))
    film: dict[str, Any] | None = None
    if fit.joint.film is not None:
        pi = isinstance(fit.joint.film, PIFilm)
        film = {"memoryless": "smooth", "operators": int(np.sum(fit.at.coefficients[fit.joint.film.free :] > 0.0))}
        film["of_the_class"] = pi
    verdict = verdict_of(bool(findings), bool(left))
    if sparse is not None and not findings and "temperature" not in left:
        verdict, next_experiment = "too_short", [f"record {sparse}", *next_experiment]
    if verdict == "clean" and any(warning.code == "out_of_time" for warning in warnings):
        verdict = "too_short"  # the time, not the record: effects that were not tried may be there
        next_experiment = ["diagnose the record again with a larger --budget, or without", *next_experiment]
    return Diagnosis(
        verdict,
        tuple(findings),
        {own.key(c): _channel(before.get(c), after.get(c), fit, c, own, record.judging) for c in own.channels},
        unexplained,
        film,
        every,
        tuple(next_experiment),
        plate_numbers(thermal),
        candidates,
        limits,
        {name: sizes for name, sizes in all_sizes.items() if name in search.assumed},
        record,
        base,
        fit,
        chosen.fit,
        less,
        search,
    )


def unlogged_K(fit: Fit) -> float:
    """Return what currents that changed between the rows, at times that no row has, make of a plate's temperature, rms:
    each change is heat for a part of a row that is known to within 1 / sqrt(12), and is forgotten with the plate's own
    time."""
    record, numbers = fit.joint.record, fit.joint.plate_numbers(fit.at.x)
    assert record.current_A is not None
    pump, resistance, conductance, drive = numbers[:4]
    kelvin = float(np.mean(fit.joint.degC)) + KELVIN
    step_s, current_A = np.diff(record.time_s), record.current_A
    heat_K = (
        (pump * kelvin + resistance * np.abs(current_A[1:]) + drive) * np.diff(current_A) * step_s / math.sqrt(12.0)
    )
    return float(np.sqrt(np.mean(heat_K**2) / (1.0 - math.exp(-2.0 * conductance * float(np.median(step_s))))))


class _Units:
    """The two channels, and the film's output in its own unit instead of the fit's decades."""

    channels: Final = {"temperature_K": "temperature", "resistance_dec": "output"}

    def __init__(self, record: Record) -> None:
        self.quantity, self.judging = record.quantity, record.judging

    def key(self, channel: str) -> str:
        """The channel's key in the JSON."""
        return channel if channel == "temperature_K" else self.quantity.channel

    def size(self, channel: str) -> float:
        """How many of the channel's own unit one of the fit's is."""
        return 1.0 if channel == "temperature_K" else self.quantity.size

    def unit(self, channel: str) -> str:
        return "K" if channel == "temperature_K" else self.quantity.unit

    def gains(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> dict[str, Gain]:
        """What is gained in the judging rows, by the channels' keys in the JSON."""
        sizes = {c: self.size(c) for c in after if c in before}
        return {self.key(c): gain(size * before[c], size * after[c], self.judging) for c, size in sizes.items()}


def _without_refused(search: Search, fit: Fit) -> tuple[Fit, dict[str, str]]:
    """Return the fit without effects that do less than what is left over, and why they are not named."""
    refused: dict[str, str] = {}
    while left_over(fit):
        less = {e.name: search.without(fit, e.name) for e in fit.effects if e.name not in search.assumed}
        weak = [name for name, without in less.items() if not outweighs(fit, without)]
        if not weak:
            break
        name = min(weak, key=lambda n: search.gain(fit, less[n]))
        refused[name] = NOT_NAMED_LEFT
        fit = less[name]
    return fit, refused


def _is_vague(parameters: Sizes) -> bool:
    """Return True if the interval of an effect's size says nothing of it."""
    value, interval = next(((v, ci) for v, ci in parameters.values() if ci is not None), (0.0, None))
    return is_vague(interval, value)


def _rounding(fit: Fit, search: Search) -> Finding | None:
    """Return the thermometer's rounding where the readings show it."""
    step, noise = fit.joint.record.step_K, fit.metric.temperature.noise.white
    effect = next((e for e in search.effects if isinstance(e.form, Reading) and e.form.rounding), None)
    if effect is None or not fit.joint.driven or not step > 0.5 * math.hypot(noise, step / math.sqrt(12.0)) > 0.0:
        return None
    evidence = fit.joint.rows_K.size * math.log(max(step / max(noise, 0.02 * step), 2.0))
    reach = NORMAL_95 * step_error(fit.joint.degC, step) + 1e-6 * step  # no file has more digits
    sizes: Sizes = {effect.parameters[0].name: (step, (step - reach, step + reach))}
    return Finding(effect.name, sizes, evidence, _chance(effect, evidence, search))


def _chance(effect: Effect, evidence: float, search: Search) -> float:
    """Return a bound of the rate at which a record without any effect reaches this evidence for one."""
    by_noise = len(search.effects) * float(chdtrc(len(effect.parameters), 2.0 * max(evidence, 0.0)))
    return min(1.0, max(by_noise, 1.0 / CLEAN_RECORDS))


def confounders(fit: Fit, name: str, search: Search) -> list[str]:
    """Return the effects that do as well in the place of a named one, of all sets that were fitted."""
    names = frozenset(e.name for e in fit.effects)
    rest = names - {name}
    found: set[str] = set()
    for key, other in search.table.items():
        new = key - rest
        if key != names and rest <= key and len(new) == 1 and search.value(other) > search.value(fit) - CLOSE:
            found |= new
    return sorted(found)


def _channel(
    before: Array | None, after: Array | None, fit: Fit, channel: str, own: _Units, judging: Mask
) -> Channel | None:
    """Return the noise of a channel and the errors in the judging rows; None for a channel that was not judged."""
    if before is None or after is None or not np.any(judging & np.isfinite(after)):
        return None
    first = channel == "temperature_K"
    noise = fit.metric.channels[0 if first else 1]
    rounding = fit.joint.record.step_K / math.sqrt(12.0) if first else 0.0
    coloured = noise.noise.slow if noise.of_instrument else 0.0
    size, counted = own.size(channel), judging & np.isfinite(after) & np.isfinite(before)
    white = math.hypot(noise.noise.white, rounding, coloured)
    return Channel(size * white, size * rms(before[counted]), size * rms(after[counted]), int(np.sum(counted)))


def _candidate(sizes: Mapping[str, Sizes], gains: Mapping[str, Gain], why: str, fit: Fit) -> Candidate:
    """Return a set of effects that is not named. gains: over what is named, or over the set without it, by channel."""
    return Candidate(
        tuple(sorted(sizes)),
        sizes,
        {c: g.rmse_before for c, g in gains.items()},
        {c: g.rmse_after for c, g in gains.items()},
        {c: g.reduction_ci95 for c, g in gains.items()},
        why,
        fit,
    )


def _candidates(
    record: Record, search: Search, fit: Fit, named: Mapping[str, Array], why: Mapping[str, str], own: _Units
) -> tuple[Candidate, ...]:
    """Return the sets that predict the deciding rows better than what is named, the likeliest first; their gain is
    measured on the judging rows."""
    names = frozenset(e.name for e in fit.effects)
    others = [(key, other) for key, other in search.table.items() if key != names and not key < names]
    others.sort(key=lambda item: -search.value(item[1]))
    found = []
    for key, other in others[:MOST_CANDIDATES]:
        errors = errors_in(other, record.held_out)
        decided = {c: gain(named[c], errors[c], record.deciding) for c in named if c in errors}
        if not any(g.rmse_after < (1.0 - LEAST_GAIN) * g.rmse_before for g in decided.values()):
            continue
        gains = own.gains(named, errors)
        reasons = [f"{name}: {why[name]}" for name in sorted(key) if name in why]
        sizes = {name: {p: (v, None) for p, v in values.items()} for name, values in other.values().items()}
        found.append(_candidate(sizes, gains, "; ".join(reasons) or ON_THE_WAY, other))
    return tuple(found)


def _in_words(share: float | None, fit: Fit, channel: str, own: _Units) -> str | None:
    """Return what is left over in a channel in words; None for nothing."""
    if share is None:
        return None
    key = "resistance_dec" if channel == "output" else "temperature_K"
    noise, size, unit = fit.metric.channels[channel == "output"].noise, own.size(key), own.unit(key)
    slow = noise.slow if noise.slow > 0.0 else share * noise.white
    text = f"a slow error of {size * slow:.2g} {unit} RMS in addition to the noise of {size * noise.white:.2g} {unit}"
    if noise.tau_s > float(np.ptp(fit.joint.record.time_s)):
        return f"{text}, correlated over the whole record"
    return f"{text}, correlated over about {rough(noise.tau_s)} s"
