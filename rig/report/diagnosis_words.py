"""Sentences on a diagnosis, for terminal, page, notebook and model file: verdict, effects, limits, warnings."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.analysis.error import split_unit
from sim.diagnosis.result import Channel, rough
from sim.effects.memoryless_term import NAME as MEMORYLESS_TERM

if TYPE_CHECKING:
    from sim.diagnosis.result import Candidate, Caution, Diagnosis, Finding, Sizes, UpperLimit

DIGITS, MOST_DIGITS = 4, 8  # of a number in words
EXACT = 1e-5  # of a value: of an interval that is narrower its digits are given
LESS = 0.98  # times an error: what a set of effects that is not named has to gain in a channel to be reported there
OFF = 1.3  # times the noise, from which the error in held-out rows is said to be larger: noise alone gives 0.9 to 1.1
MOST_NAMED = 4  # records in a title
NOT_FIXED = "not determined by this record"
SATURATED, CUT_SHORT = "heat_sink_saturated", "out_of_time"
BETWEEN_ROWS = "current_between_rows"
SHARE = "share_of_full_drive"


def lines(diagnosis: Diagnosis) -> list[str]:
    """Return what `peltier diagnose` prints, a line for each thing."""
    out = [sentence(diagnosis), *(f"  assumed: {text}" for text in assumed_lines(diagnosis))]
    for f in by_gain(diagnosis):
        other = f"; or {listed(f.indistinguishable_from, 'or')}" if f.indistinguishable_from else ""
        evidence = f"log-likelihood gain {f.evidence:,.0f}{needed(f, diagnosis)}, {false_alarms(f)}"
        out.append(f"  {f.name}: {parameters(f)}; {evidence}{other}")
    if diagnosis.record.joined.size:
        out += [f"record: {text}" for text in record_lines(diagnosis)]
    out += [error_line(*one) for one in judged_channels(diagnosis)]
    out += [f"held-out record: {text}" for text in held_out_lines(diagnosis)]
    out += plate_lines(diagnosis)
    out += [f"rooms: {text}" for text in room_line(diagnosis)]
    if diagnosis.film is not None:
        out.append(f"film: {film_words(diagnosis.film)}")
    out += [f"candidate: {text}" for text in not_named(diagnosis)]
    out += limit_lines(diagnosis)
    others = [w for w in diagnosis.warnings if w.code not in (SATURATED, CUT_SHORT)]
    out += [f"warning: {warning_line(diagnosis, w)}" for w in others]
    return [of_drive(line, diagnosis) for line in [*out, *(f"next: {text}" for text in diagnosis.next_experiment)]]


def sentence(diagnosis: Diagnosis) -> str:
    """Return the verdict in one or a few sentences."""
    first = [warning_line(diagnosis, w) for w in diagnosis.warnings if w.code in (SATURATED, CUT_SHORT)]
    first = [f"{text[:1].upper()}{text[1:]}. " for text in first]
    if diagnosis.written == "base":
        text = (
            "The extended model predicts the held-out record worse than the base model, so the base model is written. "
        )
        first.append(text)
    elif diagnosis.written == "likeliest":
        more = set(diagnosis.likeliest.values()) - {f.name for f in diagnosis.findings}
        names_of = listed(sorted(more)) if more else "fewer effects"
        first.append(
            f"The model that is written has {names_of}, which is not named: it predicts the held-out record best. "
        )
    names = [named(f, diagnosis) for f in by_gain(diagnosis)]
    left = "; ".join(left_over(diagnosis))
    if is_cut_short(diagnosis) and not names and not left:
        text = "Not decided: no effect was found until then."
    elif diagnosis.verdict == "too_short":
        text = "Rows too far apart: the film changes more from row to row than an effect of film or ohmmeter would show"
        text += f"; {left}." if left else "."
    elif diagnosis.verdict == "clean":
        unseen = [limit.name for limit in diagnosis.limits if limit.allows_all_typical]
        unseen_text = f"; {listed(unseen)} would not show in this record at any typical size" if unseen else ""
        noise = ", and the residual is noise" if is_noise(diagnosis) else ""
        text = f"{'No effect' if not noise else 'Clean: no effect'} is seen{noise}{unseen_text}."
    elif diagnosis.verdict == "explained":
        text = f"Explained: {listed(names)}." + " The residual is noise." * is_noise(diagnosis)
    elif left:
        tried = "the catalogue"
        if any(warning.code == CUT_SHORT for warning in diagnosis.warnings):
            tried = "those that were tried in the time"
        text = f"no effect of {tried} explains the residual ({left})"
        text = f"Partly unexplained: {listed(names)}; {text}." if names else f"Unexplained: {text}."
    else:
        text = f"Not confirmed: {listed(names)}."
    return of_drive("".join([*first, text, _elsewhere(diagnosis)]), diagnosis)


def of_drive(text: str, diagnosis: Diagnosis) -> str:
    """Return a text with "of full drive" in the place of A, if the record's current is a share of full drive."""
    return text if diagnosis.drive is None else re.sub(r"(?<=\d) A(?![\w\N{SUPERSCRIPT TWO}])", " of full drive", text)


def is_cut_short(diagnosis: Diagnosis) -> bool:
    """Return True if the budget ended the search."""
    return any(warning.code == CUT_SHORT for warning in diagnosis.warnings)


def is_noise(diagnosis: Diagnosis) -> bool:
    """Return True if the residual has no structure and held-out rows are predicted to about their noise."""
    return not (left_over(diagnosis) or _off(diagnosis))


def residual_words(diagnosis: Diagnosis) -> str:
    """Return the sentence on a residual without structure that an effect could explain."""
    if is_noise(diagnosis):
        return "The residual is noise."
    return "No effect was found that explains the residual, but it is larger than noise." + _elsewhere(diagnosis)


def verdict_words(diagnosis: Diagnosis) -> str:
    """Return the verdict for a card."""
    if is_cut_short(diagnosis) and not diagnosis.findings:
        return "not decided"
    if diagnosis.verdict == "clean" and not is_noise(diagnosis):
        return "no effect seen"
    return diagnosis.verdict.replace("_", " ")


def needed(finding: Finding, diagnosis: Diagnosis) -> str:
    """Return the log-likelihood that an effect has to gain to be named, in brackets; "" if it has no price."""
    effect = diagnosis.search.known.get(finding.name)
    price = diagnosis.search.cost_of(diagnosis.fit, [effect]) if effect is not None else 0.0
    return f" (needed: {price:.0f})" if price > 0.0 else ""


def false_alarms(finding: Finding) -> str:
    """Return the bound on false alarms: at most 1 in 300."""
    return f"false alarms at most 1 in {1.0 / max(finding.false_alarm, 1e-9):,.0f}"


def by_gain(diagnosis: Diagnosis) -> list[Finding]:
    """Return the findings, those that reduce an error most first."""

    def reduction(f: Finding) -> float:
        return max((1.0 - g.rmse_after / max(g.rmse_before, 1e-300) for g in f.gain.values()), default=0.0)

    return sorted(diagnosis.findings, key=lambda f: (-round(reduction(f), 1), -f.evidence))


def named(finding: Finding, diagnosis: Diagnosis) -> str:
    """Return a description of an effect with name and values, and the effects that look the same in this record."""
    values = ", ".join(quantity(name, value) for name, (value, _) in finding.parameters.items())
    effect = diagnosis.search.known.get(finding.name)
    text = f"{effect.changes} ({finding.name}, {values})" if effect is not None else f"{finding.name} ({values})"
    if finding.indistinguishable_from:
        text += f", which this record cannot distinguish from {listed(finding.indistinguishable_from, 'or')}"
    return text


def _elsewhere(diagnosis: Diagnosis) -> str:
    """Return by how much held-out rows are missed, if the residual of the fitted ones is noise."""
    off = _off(diagnosis)
    if not off or any(text is not None for text in diagnosis.unexplained.values()):
        return ""
    names = file_names([one.source for one in diagnosis.elsewhere])
    which = f"in {listed(names)}" if names else "in held-out rows"
    early = any(w.code == BETWEEN_ROWS for w in diagnosis.warnings)
    why = ", because the current changed between the rows" if early else ""
    return f" The model is off {which}: {listed(off)}{why}."


def _off(diagnosis: Diagnosis) -> list[str]:
    """Return by how much each channel's held-out rows are missed, if by more than the noise."""
    return [
        f"{what} by {rough(channel.rmse_extended / channel.noise)} times its noise"
        for what, _, channel in judged_channels(diagnosis)
        if channel.noise > 0.0 and channel.rmse_extended > OFF * channel.noise
    ]


def listed(words: Sequence[str], last: str = "and") -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def number(value: float, width: float = 0.0) -> str:
    """Return a number with four significant digits, or more if an interval of this width needs them."""
    digits = DIGITS
    if 0.0 < width < abs(value):
        digits = min(max(DIGITS, math.ceil(math.log10(abs(value) / width)) + 1), MOST_DIGITS)
    return f"{value:.{digits}g}"


def quantity(name: str, value: float) -> str:
    """Return a parameter's value with its unit, for people."""
    what, unit = split_unit(name)
    shown = f"{value:.3g}"
    if "e+" in shown and abs(value) < 1e7:  # 287,000 ohm
        shown = f"{float(shown):,.0f}"
    return f"{what} {shown} {unit}".rstrip()


def parameter(name: str, value: float, interval: tuple[float, float] | None) -> str:
    """Return a parameter with its 95 % interval: tau 2.27 s (2.25 to 2.29). An interval whose ends would say nothing
    more is given by its digits: step 0.25 K (to 6 digits)."""
    what, unit = split_unit(name)
    if interval is None:
        return f"{what} {number(value)} {unit}".rstrip() + f" ({NOT_FIXED})"
    low, high = interval
    if 0.0 < high - low < EXACT * abs(value):
        digits = min(math.floor(math.log10(2.0 * abs(value) / (high - low)) + 0.01), MOST_DIGITS)
        return f"{what} {value:.{digits}g} {unit}".rstrip() + f" (to {digits} digits)"
    text, *ends = (number(each, high - low) for each in (value, low, high))
    return f"{what} {text} {unit}".rstrip() + f" ({ends[0]} to {ends[1]})"


def parameters(finding: Finding, between: str = ", ") -> str:
    """Return all parameters of an effect; of one that has a choice of values the value alone."""
    chosen = chosen_parameters(finding)
    return between.join(
        quantity(name, value) if name in chosen else parameter(name, value, ci)
        for name, (value, ci) in finding.parameters.items()
    )


def chosen_parameters(finding: Finding) -> set[str]:
    """Return the names of those that have a choice of values, and so no interval."""
    from sim.effects.catalogue import catalogue

    effect = catalogue().get(finding.name)
    return set() if effect is None else {p.name for p in effect.parameters if p.choices}


def channels_of(diagnosis: Diagnosis) -> dict[str, tuple[str, str]]:
    """Return (what, unit) of the temperature and of the film's output, by their keys in the diagnosis."""
    film = diagnosis.record.quantity
    return {"temperature_K": ("temperature", "K"), film.channel: (film.called, film.unit)}


def judged_channels(diagnosis: Diagnosis) -> list[tuple[str, str, Channel]]:
    """Return (what, unit, channel) of each channel that the record has."""
    judged = [(what, unit, diagnosis.channels.get(key)) for key, (what, unit) in channels_of(diagnosis).items()]
    return [(what, unit, channel) for what, unit, channel in judged if channel is not None]


def error_line(what: str, unit: str, channel: Channel) -> str:
    """Return the errors in held-out rows, and the noise."""
    return (
        f"{what}: RMS error in {channel.samples_holdout} held-out rows {channel.rmse_extended:.3g} {unit}, of the base "
        f"model {channel.rmse_base:.3g} {unit}; noise {channel.noise:.3g} {unit}"
    )


def left_over(diagnosis: Diagnosis) -> list[str]:
    return [
        f"{what}: {diagnosis.unexplained[key]}"
        for key, (what, _) in channels_of(diagnosis).items()
        if diagnosis.unexplained.get(key) is not None
    ]


def film_words(film: Mapping[str, Any]) -> str:
    """Return a description of the film model."""
    kind = "Prandtl-Ishlinskii film" if film["of_the_class"] else "Preisach film"
    parts = "operators" if film["of_the_class"] else "cells of its density"
    text = f"{kind}, {film['operators']} {parts}; part without hysteresis, D(T): {film['memoryless']}"
    further = film.get("further_records", 0)
    return f"{text}; fitted to this record and to {further} earlier ones" if further else text


def candidate_set(candidate: Candidate, named: frozenset[str]) -> str:
    """Return the effects of a candidate: the new ones with their sizes, and which of the named it has and lacks."""
    of = {name: ", ".join(quantity(p, v) for p, (v, _) in own.items()) for name, own in candidate.parameters.items()}
    text = "; ".join(f"{name} ({of[name]})" for name in of if name not in named) or "fewer effects"
    if beside := [name for name in of if name in named]:
        text += f", together with {listed(beside)}"
    if without := sorted(named - of.keys()):
        text += f", without {listed(without)}"
    return text


def not_named(diagnosis: Diagnosis) -> list[str]:
    """Return the sets of effects that predict held-out rows better than what is named, and why they are not named."""
    found, names = [], frozenset(f.name for f in diagnosis.findings)
    for c in diagnosis.candidates:
        gains = [
            f"{what} {c.rmse_named[key]:.3g} to {c.rmse_holdout[key]:.3g} {unit} "
            f"({100.0 * c.reduction_ci95[key][0]:.0f} to {100.0 * c.reduction_ci95[key][1]:.0f} % less)"
            for key, (what, unit) in channels_of(diagnosis).items()
            if key in c.rmse_named and c.rmse_holdout[key] < LESS * c.rmse_named[key]
        ]
        errors = f"error in held-out rows: {', '.join(gains)}; " if gains else ""
        found.append(f"{candidate_set(c, names)}: {errors}not named because: {c.why_not_named}")
    return found


def plate_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the plate's numbers with their intervals in a line, and a line for each doubt."""
    if diagnosis.plate is None:
        return []
    values = [parameter(name, value, ci) for name, (value, ci) in diagnosis.plate.parameters.items()]
    return [f"plate: {', '.join(values)}", *(f"doubtful: {d}" for d in diagnosis.plate.doubts)]


def assumed_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the effects that were assumed, with their parameters; one that was given has no interval."""

    def own(sizes: Sizes) -> Iterable[str]:
        return (quantity(name, v) if ci is None else parameter(name, v, ci) for name, (v, ci) in sizes.items())

    return [f"{effect}: {', '.join(own(sizes))}" for effect, sizes in diagnosis.assumed.items()]


def limit_rows(diagnosis: Diagnosis) -> list[list[str]]:
    """Return (effect, the sizes that the record still allows, the typical range) of each effect that is not named."""
    return [
        [
            limit.name,
            "cannot be seen in this record" if limit.allows_all_typical else of_drive(_allowed(limit), diagnosis),
            _typical(limit) or "\N{EN DASH}",
        ]
        for limit in _limits(diagnosis)
    ]


def _limits(diagnosis: Diagnosis) -> list[UpperLimit]:
    """Return the limits of effects that do not stand in for a named one."""
    instead = {name for finding in diagnosis.findings for name in finding.indistinguishable_from}
    return [limit for limit in diagnosis.limits if limit.name not in instead]


def _typical(limit: UpperLimit) -> str:
    return " to ".join(map(rough, limit.typical or ()))


def _allowed(limit: UpperLimit) -> str:
    """Return the sizes that the record still allows: tau below 0.62 s."""
    what, unit = split_unit(limit.parameter)
    if limit.limit is None:
        return f"{what} of any size"
    return f"{what} {'above' if limit.from_below else 'below'} {rough(limit.limit)} {unit}".rstrip()


def limit_lines(diagnosis: Diagnosis) -> list[str]:
    """Return which effects the record excludes, which it allows up to a size, and which it cannot show.

    An effect that may stand in for a named one is listed there."""
    kinds: dict[str, list[str]] = {
        "excluded at every typical size (95 %)": [],
        "not seen, still possible at this size (95 %)": [],
        "this record cannot show": [],
    }
    whole, to_a_size, unseen = kinds.values()
    for limit in _limits(diagnosis):
        kind = whole if limit.excludes_all_typical else unseen if limit.allows_all_typical else to_a_size
        typical = f", typical {_typical(limit)}" if limit.typical else ""
        kind.append(limit.name if kind is unseen else f"{limit.name} ({_allowed(limit)}{typical})")
    return [f"{what}: {'; '.join(names)}" for what, names in kinds.items() if names]


def file_names(sources: list[str]) -> list[str]:
    """Return files without their folders; with them where names are alike."""
    short = [Path(source).name for source in sources]
    return short if len(set(short)) == len(short) else sources


def together(diagnosis: Diagnosis) -> str:
    """Return the files that were diagnosed in a line: of many the first ones, and how many more."""
    names = file_names(list(diagnosis.sources))
    more = len(names) - MOST_NAMED
    return listed([*names[:MOST_NAMED], f"{more} more"] if more > 0 else names)


def record_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the rows of each record: how many, over how long, how far apart, with how many gaps."""
    record, found = diagnosis.record, []
    names = file_names(list(diagnosis.sources)) if record.joined.size else list(diagnosis.sources)
    for name, part in zip(names, record.parts, strict=True):
        time = record.file_s[part]
        length_s = float(time[-1] - time[0])
        length = f"{length_s / 3600.0:.2g} h" if length_s >= 3600.0 else f"{length_s:.0f} s"
        gaps = record.gaps_in(part).size
        text = f"{name}: {time.size} rows over {length}, one every {record.interval_of(part):.3g} s"
        found.append(f"{text}, {gaps} gap{'s' * (gaps > 1)}" if gaps else text)
    return found


def room_line(diagnosis: Diagnosis) -> list[str]:
    """Return each record's room temperature if there are several records; that of one is a parameter of the plate."""
    rooms = diagnosis.rooms_degC
    if len(rooms) < 2:
        return []
    names = file_names(list(diagnosis.sources))
    return [", ".join(f"{name} {number(room)} \N{DEGREE SIGN}C" for name, room in zip(names, rooms, strict=True))]


def held_out_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the errors of extended and base model on each of the other records, and the room fitted there."""
    found = []
    for name, other in zip(file_names([one.source for one in diagnosis.elsewhere]), diagnosis.elsewhere, strict=True):
        errors = []
        for key, (what, unit) in channels_of(diagnosis).items():
            if key in other.errors:
                base, extended, rows = other.errors[key]
                errors.append(f"{what} {number(extended)} {unit}, base model {number(base)} {unit} ({rows} rows)")
        if other.ambient_degC is not None:
            errors.append(f"room {number(other.ambient_degC)} \N{DEGREE SIGN}C")
        found.append(f"{name}: {'; '.join(errors)}")
    return found


def warning_line(diagnosis: Diagnosis, caution: Caution) -> str:
    """Return a warning, with its record, where there are several, and from when to when."""
    of = "" if caution.record is None else f"{file_names(list(diagnosis.sources))[caution.record - 1]}: "
    when = ""
    if caution.from_s is not None and caution.to_s is not None:
        when = f" (from {caution.from_s:.0f} to {caution.to_s:.0f} s)"
    return f"{of}{caution.text}{when}"


def model_comment(diagnosis: Diagnosis) -> str:
    """Return the comment at the top of the extended model's file: doubtful numbers, sizes that are not determined."""
    found = [f"extended model of the diagnosis of {together(diagnosis)}", *unit_lines(diagnosis)]
    if diagnosis.written == "base":
        found = [f"base model of the diagnosis of {together(diagnosis)}: it predicts the held-out record better"]
    if diagnosis.plate is not None:
        found += [f"plate: {doubt}" for doubt in diagnosis.plate.doubts]
    for finding in diagnosis.findings:
        if finding.name != MEMORYLESS_TERM:  # the film's, and no number of an effect
            chosen = chosen_parameters(finding)
            found += [
                f"{finding.name}: {name}: {NOT_FIXED}"
                for name, (_, interval) in finding.parameters.items()
                if interval is None and name not in chosen
            ]
    return "\n".join(found)


def unit_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the line that says that A stands for the full drive, if it does."""
    return [warning.text for warning in diagnosis.warnings if warning.code == SHARE]
