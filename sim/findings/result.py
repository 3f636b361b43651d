"""What a diagnosis has found: named effects with intervals and gains, what is left over, and its JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.special import chdtrc

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Reading
from sim.findings.candidates import possible
from sim.findings.films import PIFilm
from sim.findings.held_out import errors_in
from sim.findings.intervals import Interval, intervals, is_vague
from sim.findings.search import Search, explains_most, left_over
from sim.inference.joint import Fit
from sim.model.recorded import Mask

CLOSE: Final = math.log(20.0)  # log-likelihood: a set that is this close is as likely, but for odds of 20
RESAMPLES: Final = 1000  # of a gain's interval: its ends are then within 3 % of its width
BLOCKS: Final = 60  # of rows, drawn together: longer than residuals hang together
KEYS: Final = {"temperature": "temperature_K", "output": "resistance_dec"}
QUANTIZATION: Final = "thermometer_quantization"


@dataclass(frozen=True)
class Gain:
    """Root mean square error in held-out rows without and with an effect, and the 95 % interval of its reduction."""

    rmse_before: float
    rmse_after: float
    reduction_ci95: Interval


@dataclass(frozen=True)
class Finding:
    """A named effect. evidence: log-likelihood that is lost without it; false_alarm: how often chance would reach that
    for some effect, a bound; indistinguishable_from: effects that do as well in its place."""

    name: str
    parameters: Mapping[str, tuple[float, Interval | None]]
    evidence: float
    false_alarm: float
    indistinguishable_from: tuple[str, ...]
    gain: Mapping[str, Gain]


@dataclass(frozen=True)
class Channel:
    """Noise of an instrument, and the errors of base and extended model in held-out rows."""

    noise: float
    rmse_base: float
    rmse_extended: float
    samples_holdout: int


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """verdict; findings, the most evident first; channels and what is left over in words, by JSON key; candidates: what
    was found and is not named, with the reason; film: of which kind."""

    verdict: str
    findings: Sequence[Finding]
    channels: Mapping[str, Channel | None]
    unexplained: Mapping[str, str | None]
    not_named: Mapping[str, str]
    film: Mapping[str, Any] | None
    fit: Fit
    base: Fit
    warnings: Sequence[str] = field(default=())

    def document(self) -> dict[str, Any]:
        """The JSON of `peltier diagnose`, format peltier-diagnosis/1, as far as this knows it."""
        return {
            "format": "peltier-diagnosis/1",
            "verdict": self.verdict,
            "effects": [
                {
                    "name": f.name,
                    "parameters": {
                        name: {"value": value, "ci95": None if ci is None else list(ci)}
                        for name, (value, ci) in f.parameters.items()
                    },
                    "evidence": f.evidence,
                    "false_alarm": f.false_alarm,
                    "false_alarm_kind": "bound",
                    "indistinguishable_from": list(f.indistinguishable_from),
                    "gain": {
                        key: {
                            "rmse_before": g.rmse_before,
                            "rmse_after": g.rmse_after,
                            "reduction_ci95": list(g.reduction_ci95),
                        }
                        for key, g in f.gain.items()
                    },
                }
                for f in self.findings
            ],
            "channels": {key: None if c is None else dict(vars(c)) for key, c in self.channels.items()},
            "unexplained": dict(self.unexplained),
            "film": self.film,
            "not_named": dict(self.not_named),
            "warnings": list(self.warnings),
        }


def result(
    base: Fit,
    fit: Fit,
    search: Search,
    held: Mask,
    warnings: Sequence[str] = (),
    say: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """The diagnosis of a selected set. held: rows for the errors that are reported."""
    left = left_over(fit)
    reasons: dict[str, str] = {}
    less = {e.name: search.without(fit, e.name) for e in fit.effects}
    for name, without in less.items():
        if left and not explains_most(fit, without):
            reasons[name] = "more is left over than this effect explains"
    for name, own in intervals(fit).items():
        value, interval = next(((v, ci) for v, ci in own.values() if ci is not None), (0.0, None))
        if is_vague(interval, value):
            reasons.setdefault(name, "likely, but the record does not fix its size")
    findings = _findings(fit, less, reasons, search, held, say)
    bare = errors_in(base, held)
    whole = errors_in(fit, held)
    channels: dict[str, Channel | None] = dict.fromkeys(KEYS.values())
    for (channel, key), noise in zip(KEYS.items(), fit.metric.channels, strict=False):
        if key in whole and key in bare:
            after = whole[key][np.isfinite(whole[key])]
            rounding = fit.joint.record.step_K / math.sqrt(12.0) if channel == "temperature" else 0.0
            size = noise.noise.slow if noise.of_instrument else 0.0
            white = math.hypot(noise.noise.white, rounding, size)
            before = bare[key][np.isfinite(bare[key])]
            channels[key] = Channel(white, _rms(before), _rms(after), int(after.size))
    unexplained = {key: _in_words(left.get(name), fit, name) for name, key in KEYS.items()}
    named = bool(findings)
    verdict = ("partly_unexplained" if named else "unexplained") if left else ("explained" if named else "clean")
    kind = None
    if fit.joint.film is not None:
        kind = {"kind": "extended_generalized_pi" if isinstance(fit.joint.film, PIFilm) else "preisach"}
    return Diagnosis(verdict, findings, channels, unexplained, reasons, kind, fit, base, warnings)


def _findings(
    fit: Fit,
    less: Mapping[str, Fit],
    reasons: Mapping[str, str],
    search: Search,
    held: Mask,
    say: Callable[[str], None],
) -> list[Finding]:
    sizes = intervals(fit)
    names = [e.name for e in fit.effects if e.name not in reasons]
    whole = errors_in(fit, held) if names else {}
    found = []
    for effect in fit.effects:
        if effect.name not in names:
            continue
        say(f"gain of {effect.name}")
        evidence = search.gain(fit, less[effect.name])
        rest = errors_in(less[effect.name], held)
        gains = {key: _gain(rest[key], whole[key]) for key in whole if key in rest}
        alike = tuple(confounders(fit, effect, search))
        found.append(
            Finding(effect.name, sizes[effect.name], evidence, _chance(effect, evidence, search), alike, gains)
        )
    step = fit.joint.record.step_K
    noise = fit.metric.temperature.noise.white
    rounding = next((e for e in search.effects if isinstance(e.form, Reading) and e.form.rounding), None)
    if rounding is not None and fit.joint.driven and step > 0.5 * math.hypot(noise, step / math.sqrt(12.0)) > 0.0:
        rows = fit.joint.rows_K.size
        evidence = rows * math.log(max(step / max(noise, 0.02 * step), 2.0))
        value = {rounding.parameters[0].name: (step, (step * (1.0 - 1e-6), step * (1.0 + 1e-6)))}
        found.append(Finding(rounding.name, value, evidence, _chance(rounding, evidence, search), (), {}))
    return sorted(found, key=lambda f: -f.evidence)


def _chance(effect: Effect, evidence: float, search: Search) -> float:
    """A bound of the rate at which a record without any effect reaches this evidence for one."""
    return min(1.0, len(search.effects) * float(chdtrc(len(effect.parameters), 2.0 * max(evidence, 0.0))))


def confounders(fit: Fit, effect: Effect, search: Search) -> list[str]:
    """Effects that do as well in the place of a named one, of all sets that were fitted."""
    names = frozenset(e.name for e in fit.effects)
    rest = names - {effect.name}
    found: list[str] = []
    for key, other in search.table.items():
        new = key - rest
        in_its_place = key != names and rest <= key and len(new) == 1
        if in_its_place and search.value(other) > search.value(fit) - CLOSE:
            found.extend(new)
    return sorted(found)


def unseen(fit: Fit, search: Search) -> list[Effect]:
    """The effects that the record could show and that are not named."""
    have = {e.name for e in fit.effects}
    return [e for e in possible(search.effects, fit.joint) if e.name not in have]


def _gain(before: Array, after: Array) -> Gain:
    """Of held-out rows, nan elsewhere; blocks drawn with replacement (H. R. Kuensch, Ann. Statist. 17 (1989) 1217)."""
    rows = np.flatnonzero(np.isfinite(before) & np.isfinite(after))
    _, place = np.unique(rows * BLOCKS // max(before.size, 1), return_inverse=True)
    count = int(place.max(initial=-1)) + 1
    b, a = (np.bincount(place, values[rows] ** 2, minlength=count) for values in (before, after))
    draw = np.random.default_rng(0).integers(0, max(count, 1), (RESAMPLES, count))
    reduction = 1.0 - np.sqrt(a[draw].sum(axis=1) / np.maximum(b[draw].sum(axis=1), 1e-300))
    low, high = (float(v) for v in np.percentile(reduction, [2.5, 97.5]))
    return Gain(_rms(before[rows]), _rms(after[rows]), (low, high))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def _in_words(share: float | None, fit: Fit, channel: str) -> str | None:
    """What is left over in a channel."""
    if share is None:
        return None
    noise = fit.metric.channels[channel == "output"].noise
    unit = "dec" if channel == "output" else "K"
    size = noise.slow if noise.slow > 0.0 else share * noise.white
    return f"{size:.2g} {unit} beyond the noise of {noise.white:.2g} {unit}, over about {noise.tau_s:.2g} s"
