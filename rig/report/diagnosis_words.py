"""A diagnosis in words: the verdict in one sentence, each effect with its parameters, what is left, what to do next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.diagnosis.data.rough_number import rough

if TYPE_CHECKING:
    from sim.diagnosis.report.candidates import Candidate
    from sim.diagnosis.report.upper_limits import UpperLimit
    from sim.diagnosis.result import Channel, Diagnosis, Finding

DIGITS, MOST_DIGITS = 4, 8  # of a number in words
EXACT = 1e-5  # of a value: an interval that is narrower is told by its digits
LESS = 0.98  # times an error: what a set of effects that is not named has to gain in a channel to be reported there
PERCOLATES = 0.25  # percolation from which a film is told to percolate: half as steep as an effective medium
NOT_FIXED = "not fixed by this record"
BETWEEN_ROWS = "the film between two of them may do what any effect of film or ohmmeter does"


def channels_of(diagnosis: Diagnosis) -> dict[str, tuple[str, str]]:
    """(what, unit) of the temperature and of the film's output, by their keys in the diagnosis."""
    film = diagnosis.record.quantity
    return {"temperature_K": ("temperature", "K"), film.channel: (film.called, film.unit)}


def file_names(sources: list[str]) -> list[str]:
    """Files without their folders; with them where names are alike."""
    short = [Path(source).name for source in sources]
    return short if len(set(short)) == len(short) else sources


def listed(words: list[str]) -> str:
    """one, two and three."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def number(value: float, width: float = 0.0) -> str:
    """Four digits that matter, no needless exponent; more where an interval is so narrow that its ends would be alike.
    width: of that interval."""
    digits = DIGITS
    if 0.0 < width < abs(value):
        digits = min(max(DIGITS, math.ceil(math.log10(abs(value) / width)) + 1), MOST_DIGITS)
    return f"{value:.{digits}g}"


def parameter(name: str, value: float, interval: tuple[float, float] | None) -> str:
    """tau_s 2.27 (2.25 to 2.29); without an interval it is one that the record does not fix. An interval whose ends
    would say nothing more is told by its digits: step_K 0.25 (to 6 digits)."""
    if interval is None:
        return f"{name} {number(value)} ({NOT_FIXED})"
    low, high = interval
    if 0.0 < high - low < EXACT * abs(value):
        digits = min(math.floor(math.log10(2.0 * abs(value) / (high - low)) + 0.01), MOST_DIGITS)
        return f"{name} {value:.{digits}g} (to {digits} digits)"
    value_text, *ends = (number(each, high - low) for each in (value, low, high))
    return f"{name} {value_text} ({ends[0]} to {ends[1]})"


def parameters(finding: Finding, between: str = ", ") -> str:
    """All parameters of an effect with their 95 % intervals; of one that has a choice of values the value alone."""
    chosen = chosen_parameters(finding)
    return between.join(
        f"{name} {number(value)}" if name in chosen else parameter(name, value, ci)
        for name, (value, ci) in finding.parameters.items()
    )


def chosen_parameters(finding: Finding) -> set[str]:
    """Those that have a choice of values, and so no interval."""
    from sim.effects.catalogue import catalogue

    return {p.name for p in catalogue()[finding.name].parameters if p.choices}


def named(finding: Finding) -> str:
    """The effect with its values, and what it cannot be distinguished from."""
    values = ", ".join(f"{name} {value:.3g}" for name, (value, _) in finding.parameters.items())
    text = f"{finding.name} ({values})"
    if finding.indistinguishable_from:
        text += f", which this record cannot distinguish from {listed(finding.indistinguishable_from)}"
    return text


def judged_channels(diagnosis: Diagnosis) -> list[tuple[str, str, Channel]]:
    """(what, unit, channel) of each channel that the record has."""
    found = []
    for key, (what, unit) in channels_of(diagnosis).items():
        channel = diagnosis.channels[key]
        if channel is not None:
            found.append((what, unit, channel))
    return found


def left_over(diagnosis: Diagnosis) -> list[str]:
    """What is left in each channel, as the JSON has it."""
    left = diagnosis.left
    return [f"{what}: {left[key]}" for key, (what, _) in channels_of(diagnosis).items() if left[key] is not None]


def nothing_left(diagnosis: Diagnosis) -> str:
    """What is said where nothing is left."""
    nothing = "Nothing is left beyond the noise"
    if diagnosis.verdict == "too_short":
        return f"{nothing} in the rows that there are; {BETWEEN_ROWS}."
    return f"{nothing}."


def sentence(diagnosis: Diagnosis) -> str:
    """The verdict."""
    from sim.diagnosis.result import ONLY_UNSEEN, SHORTFALL

    names_of = channels_of(diagnosis)
    left = [f"{names_of[key][0]}: {text}" for key, text in diagnosis.unexplained.items() if text is not None]
    names = [named(f) for f in diagnosis.findings]
    rest = f"something is left that no effect of the catalogue explains ({'; '.join(left)})"
    if all(text is None or text.startswith(ONLY_UNSEEN) for text in diagnosis.unexplained.values()):
        rest = f"{'; '.join(left)}, though nothing is left in the fitted rows: what was fitted {SHORTFALL}"
    nothing = f"nothing is left beyond the noise{_own_steps(diagnosis)}"
    if diagnosis.missed:
        nothing += " in the fitted rows"
    if diagnosis.verdict == "clean":
        return f"Clean: no effect is seen, and {nothing}{_unseen(diagnosis)}.{_elsewhere(diagnosis)}"
    if diagnosis.verdict == "explained":
        these = "them" if len(names) > 1 else "it"
        return f"Explained: {listed(names)}; with {these} {nothing}.{_elsewhere(diagnosis)}"
    if diagnosis.verdict == "too_short" and not left:
        return f"Too few rows: {BETWEEN_ROWS}; none was looked for."
    if diagnosis.verdict == "too_short":
        return f"Too few rows: what is left may be the film between two of them ({'; '.join(left)}); none is blamed."
    if diagnosis.verdict == "partly_unexplained":
        return f"Partly unexplained: {listed(names)}; besides, {rest}."
    return f"Unexplained: {rest}; none is blamed."


def _elsewhere(diagnosis: Diagnosis) -> str:
    """Where held-out rows are missed: whether the verdict holds for them too, but for what their first rows leave open,
    or for the fitted rows alone."""
    if not diagnosis.missed:
        return ""
    names_of, names = channels_of(diagnosis), file_names([held.source for held in diagnosis.elsewhere])
    which = f"the held-out record{'s' * (len(names) > 1)} {listed(names)}" if names else "the held-out rows"
    off = "; ".join(f"{names_of[key][0]} is {text}" for key, text in diagnosis.missed.items())
    if all(diagnosis.open_at_first(key) for key in diagnosis.missed):
        own = "of a room, of first temperatures and of a memory"
        return f" It holds for {which} too, but for what first rows leave open {own}: {off} there."
    return f" That holds for what was fitted, not for {which}: {off} there."


def _own_steps(diagnosis: Diagnosis) -> str:
    """What counts as the film's own beside the noise, where it switches in steps."""
    domains, unit = (diagnosis.film or {}).get("domains"), diagnosis.record.quantity.unit
    if domains is None:
        return ""
    return f" and what counts as the film's own steps ({rough(domains[f'own_{unit}'])} {unit} RMS)"


def _unseen(diagnosis: Diagnosis) -> str:
    """What may be there all the same, of any usual size."""
    names = [limit.name for limit in diagnosis.limits if limit.allows_all_met]
    return f"; {listed(names)} would not have shown in this record at a usual size" if names else ""


def gain_line(what: str, unit: str, channel: Channel) -> str:
    """Held-out error before and after beside the noise."""
    besides = ""
    if channel.leaves_open:
        besides = f", {number(channel.expected)} {unit} with what this record leaves open"
    return (
        f"{what}: {number(channel.rmse_base)} {unit} before, {number(channel.rmse_extended)} {unit} after, "
        f"noise {number(channel.noise)} {unit}{besides} ({channel.samples_holdout} held-out rows)"
    )


def candidate_set(candidate: Candidate, named: frozenset[str]) -> str:
    """What a set of effects has that is not named, beside what of those named, and without which of them: it was fitted
    in their place, so that an effect that is named may have another size in it."""
    sizes = {
        name: ", ".join(f"{p} {value:.3g}" for p, value in own.items()) for name, own in candidate.parameters.items()
    }
    text = "; ".join(f"{name} ({sizes[name]})" for name in sizes if name not in named) or "fewer effects"
    if beside := [f"{name} (named above, here with {sizes[name]})" for name in sizes if name in named]:
        text += f", beside {listed(beside)}"
    if without := sorted(named - sizes.keys()):
        text += f", without {listed(without)}"
    return text


def not_named(diagnosis: Diagnosis) -> list[str]:
    """Sets of effects that predict held-out rows better than what is named, and why they are not named."""
    found = []
    for c in diagnosis.candidates:
        gains = ", ".join(
            f"{what} {number(c.rmse_named[key])} to {number(c.rmse_holdout[key])} {unit} "
            f"({100.0 * c.reduction_ci95[key][0]:.0f} to {100.0 * c.reduction_ci95[key][1]:.0f} % less)"
            for key, (what, unit) in channels_of(diagnosis).items()
            if key in c.rmse_named and c.rmse_holdout[key] < LESS * c.rmse_named[key]
        )
        found.append(
            f"{candidate_set(c, diagnosis.judged.fitted)}: {gains} on held-out rows. Not named: {c.why_not_named}"
        )
    return found


def plate_lines(diagnosis: Diagnosis) -> list[str]:
    """The plate's numbers with their intervals in a line, and what is doubtful of them in a line each."""
    if diagnosis.plate is None:
        return []
    values = [parameter(name, value, ci) for name, (value, ci) in diagnosis.plate.parameters.items()]
    return [f"{diagnosis.plate.kind}: {', '.join(values)}", *(f"doubtful: {d}" for d in diagnosis.plate.doubts)]


def assumed_lines(diagnosis: Diagnosis) -> list[str]:
    """The effects that were assumed, with their parameters."""
    return [
        f"{effect}: {', '.join(_assumed(name, value, ci) for name, (value, ci) in own.items())}"
        for effect, own in diagnosis.assumed.items()
    ]


def _assumed(name: str, value: float, interval: tuple[float, float] | None) -> str:
    """One that was given has no interval."""
    return f"{name} {number(value)}" if interval is None else parameter(name, value, interval)


def limit_rows(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """(effect, the sizes that the record still allows, the usual sizes) of each effect that is not named."""
    return [(limit.name, _allowed(limit), _usual(limit)) for limit in diagnosis.limits]


def _usual(limit: UpperLimit) -> str:
    """The usual sizes; none of an effect whose sizes are in a unit that the record does not have."""
    return "\N{EN DASH}" if limit.met is None else f"{rough(limit.met[0])} to {rough(limit.met[1])}"


def _allowed(limit: UpperLimit) -> str:
    """The sizes that the record still allows: tau_s below 0.62."""
    if limit.limit is None:
        return f"{limit.parameter} any"
    return f"{limit.parameter} {'above' if limit.from_below else 'below'} {rough(limit.limit)}"


def limit_lines(diagnosis: Diagnosis) -> list[str]:
    """What the record excludes whole, what it allows up to a size, and what may be there in any usual size. An effect
    that may be there instead of one that is named is excluded beside that one only, and is listed there."""
    kinds: dict[str, list[str]] = {
        "not there, in any usual size (at 95 %)": [],
        "not seen, and at 95 % no larger than": [],
        "would not have shown at a usual size": [],
    }
    whole, to_a_size, unseen = kinds.values()
    instead = {name for finding in diagnosis.findings for name in finding.indistinguishable_from}
    for limit in diagnosis.limits:
        if limit.name in instead:
            continue
        kind = whole if limit.excludes_all_met else unseen if limit.allows_all_met else to_a_size
        kind.append(limit.name if limit.limit is None else f"{limit.name} ({_allowed(limit)})")
    return [f"{what}: {'; '.join(names)}" for what, names in kinds.items() if names]


def told_by(film: Mapping[str, Any]) -> str:
    """Which records the film's model comes from, where it is not this one alone."""
    further = film.get("further_records", 0)
    return f"; told by this record and {further} before it" if further else ""


def mixing_in_words(diagnosis: Diagnosis) -> str:
    """How the film's phases add up where it is not in their logarithms; empty where it is."""
    found = (diagnosis.film or {}).get("mixing")
    if not found:
        return ""
    values = ", ".join(f"{name} {rough(each['value'])}" for name, each in found.items())
    exponent, percolation = (found[name]["value"] for name in ("exponent", "percolation"))
    sharpness = math.hypot(exponent, math.sqrt(percolation))
    how = "a power mean of resistances"
    meaning = "exponent -1: domains in parallel, 0: logarithms add, 1: in series"
    if percolation >= PERCOLATES:
        how, threshold = "an effective medium", 0.5 * (1.0 + exponent / sharpness)
        meaning = f"its metal percolates at a share of about {threshold:.1g}, with a critical exponent of about "
        meaning += f"{1.0 / sharpness:.1g}"
    left_out = "model files leave out that the step between the phases changes"
    return f"its phases mix about as {how} ({values}; {meaning}); {left_out}"
