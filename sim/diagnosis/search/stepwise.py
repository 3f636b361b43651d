"""From all effects to those that one end of the chain needs: forward, swapped, backward."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.search.budget import SEARCHING
from sim.diagnosis.search.delays import TIMING, best_timed, likely_timed
from sim.diagnosis.search.gap_memory import has_gaps, plain_through_gaps, through_gaps
from sim.diagnosis.search.meaning import has_meaning
from sim.diagnosis.search.resistance_search import FINER, RELAYS_FROM, ResistanceSearch
from sim.diagnosis.search.restarts import restarted
from sim.diagnosis.search.temperature_search import TemperatureSearch
from sim.effects.effect import Reading

ENTRY = 6.0  # log-likelihood of the fitted rows from which an effect is followed up
ABSORBS = 20.0  # the same where the film is of another kind: what its relays lack may look like an effect
CHOICE = 5.0  # what an effect has to bring besides for each of its values that was chosen among several
PASSES = 4.0  # of a score test: log-likelihood from which an effect is tried
MOST_EFFECTS = 4  # one more than the blind cases ever hide
TRIED = 4  # candidates followed to the end in a round
ROUGH = 1.5  # mean square residual over noise from which every candidate is tried
RELAYED = 1.1  # mean square residual over noise that relays leave, at which the film is one of another kind
WIDENED = 2  # candidates that get relays
FAR_FROM_NOISE = 30.0  # mean square residual over noise
LITTLE_CHANGED = 0.7
LEAVES_LESS = 0.5  # of what another kind of plate, or order of lags, leaves: the right one leaves little but the noise
NOTHING_CHANGED = 0.01  # of what is left: the largest there is would never account for it
LITTLE_BESIDE = 0.1  # the same beside relays, which do most of what a film can do
Progress = Callable[[str], None]
Timed = Callable[[ResistanceSearch, frozenset[str]], frozenset[str]]


def _hopeless(before: float, after: float, rows: int) -> bool:
    """Whether the best effect there is changes little of a residual many times the noise: then it is none of these."""
    square = 2.0 * after / rows
    return square > FAR_FROM_NOISE and square > LITTLE_CHANGED * 2.0 * before / rows


def _in_vain(before: ResistanceFit, after: ResistanceFit, rows: int) -> bool:
    """Whether the best effect there is leaves what is well beyond the noise as it was."""
    share = LITTLE_BESIDE if before.parameters.has_relays and after.parameters.has_relays else NOTHING_CHANGED
    gone = before.minus_log - after.minus_log
    return 2.0 * after.minus_log / rows > ROUGH and gone < share * (before.minus_log - 0.5 * rows)


def select_first_links(search: TemperatureSearch, names: frozenset[str] = frozenset()) -> frozenset[str]:
    """The effects that the thermometer's channel alone asks for, beside those assumed. names: where the search
    begins."""
    names = _improved_first(search, names | search.assumed)
    while len(names - search.assumed) < MOST_EFFECTS and not search.budget.over(SEARCHING):
        fit = search.fit(names)
        others = [n for n in search.effects if n not in names]
        rough = 2.0 * fit.minus_log / search.channel.rows.size > ROUGH
        scores = {n: search.score_test(fit, n) for n in others}
        order = sorted(others, key=lambda n: -scores[n])
        tried = order if rough else [n for n in order if scores[n] > PASSES][:TRIED]
        found = {n: search.fit(names | {n}, fit) for n in search.budget.in_time(tried)}
        gains = {n: fit.minus_log - f.minus_log for n, f in found.items() if has_meaning(search, f)}
        if not gains or max(gains.values()) < ENTRY:
            break
        best = max(gains, key=lambda n: gains[n])
        if _hopeless(fit.minus_log, found[best].minus_log, search.channel.rows.size):
            break
        names |= {best}
        search.walked(names)
        names = _improved_first(search, names)
    return names


def _improved_first(search: TemperatureSearch, names: frozenset[str]) -> frozenset[str]:
    """Swaps and removals until none is better."""
    for _ in range(4):  # nearly all end in the second turn
        best, changed = search.fit(names).minus_log, names
        for name in search.budget.in_time(sorted(names - search.assumed)):
            rest = names - {name}
            fit = search.without(search.fit(names), name)
            if fit.minus_log - best < ENTRY:
                return _improved_first(search, rest)
            if not rest:
                continue  # the only one was the best of all
            scores = {n: search.score_test(fit, n) for n in search.effects if n not in names}
            likely = sorted((n for n in scores if scores[n] >= PASSES), key=lambda n: -scores[n])
            for other in search.budget.in_time(likely[:TRIED]):
                trial = search.fit(rest | {other}, fit)
                if trial.minus_log < best - 1.0 and (search.channel.misfit == 1.0 or has_meaning(search, trial)):
                    best, changed = trial.minus_log, rest | {other}
        if changed == names:
            break
        names = changed
    return names


def entry_of(fit: ResistanceFit, known: frozenset[str] = frozenset()) -> float:
    """What an effect of the last links, besides those known, has to bring in the fitted rows."""
    if not fit.parameters.has_relays:
        return ENTRY
    choosy = any(p.choices for e in fit.effects if e.name not in known for p in e.effect.parameters)
    return ABSORBS + choosy * CHOICE


def select_last_links(
    search: ResistanceSearch,
    names: frozenset[str] = frozenset(),
    steps: int = MOST_EFFECTS,
    say: Progress = lambda text: None,
) -> frozenset[str]:
    """The effects that the ohmmeter's channel alone asks for, beside those assumed. names: where the search begins;
    steps: how many times one is added, or two at once."""
    names |= search.assumed
    begun_with = names
    for _ in range(steps):
        if len(names - search.assumed) >= MOST_EFFECTS or search.budget.over(SEARCHING):
            break
        say(f"temperature to resistance{': besides ' if names else ''}{', '.join(sorted(names))}")
        fit = search.ended(search.fit(names))
        fit = restarted(search, fit) if steps > 1 else fit  # one step is for the noise, beside which all begins anew
        found, rows = _one_more(search, fit), search.channel.rows.size
        if found is not None and found.parameters.has_relays:  # of two fits of another film, the better one
            found = search.ended(found)
            fit = search.ended(search.without(found, next(e.name for e in found.effects if e.name not in names)))
        if found is None or found.score - fit.score < entry_of(found, names) or _in_vain(fit, found, rows):
            if search.budget.over(SEARCHING):
                break
            found = search.two_at_once(fit) if len(names - search.assumed) + 2 <= MOST_EFFECTS else None
            if found is None or not has_meaning(search, found):
                break
            if found.score - fit.score < 2.0 * entry_of(found) or _in_vain(fit, found, rows):
                break
        if _hopeless(fit.minus_log, found.minus_log, rows):
            break
        if search.channel.mean_square(found) > FAR_FROM_NOISE:  # in envelopes that were bent to do without it
            found = _at_another_size(search, found, names)
        if has_gaps(search):
            found = through_gaps(search, found)
        if steps > 1:
            found = restarted(search, search.ended(found))
        names = frozenset(e.name for e in found.effects)
        names = _improved_last(search, names, best_timed if steps > 1 else likely_timed)
    delayed = bool(begun_with & TIMING) and search.fit(names).parameters.has_relays
    return best_timed(search, names) if delayed else names  # they were compared beside another noise


def _at_another_size(search: ResistanceSearch, found: ResistanceFit, before: frozenset[str]) -> ResistanceFit:
    """The fit, or a better one with what it has besides those before at another size, from envelopes searched for
    beside each: no descent leads from a drift of -0.3 K/h to one of -0.9."""
    new = [e.name for e in found.effects if e.name not in before]
    anew = [search.instead(found, name, name, anew=True) for name in search.budget.in_time(new)]
    return max([found, *(f for f in anew if has_meaning(search, f))], key=lambda f: f.score)


def _one_more(
    search: ResistanceSearch, fit: ResistanceFit, beside: frozenset[str] = frozenset()
) -> ResistanceFit | None:
    """The best fit with one more effect: some steps for each that passes a score test, to the end for the best few."""
    names = frozenset(e.name for e in fit.effects)
    others = [n for n in search.effects if n not in names and n not in beside]
    if fit.parameters.has_relays and search.channel.mean_square(fit) <= RELAYED:
        return _one_more_beside(search, fit, others)
    rough = search.channel.mean_square(fit) > ROUGH
    tests = search.score_tests(fit, others)
    best = {n: max(each, key=lambda test: test.gain) for n, each in tests.items()}
    tried = sorted((n for n in others if rough or best[n].gain > PASSES), key=lambda n: -best[n].gain)
    budget = search.budget
    quick = [search.quick(fit, n, best[n]) for n in budget.in_time(tried if rough else tried[:TRIED])]
    quick = sorted((q for q in quick if np.isfinite(q.score)), key=lambda q: -q.score)
    ends = [search.plain(q.parameters) for q in budget.in_time(quick[:TRIED])]
    ends = [e for e in ends if np.isfinite(e.score) and has_meaning(search, e)]
    if has_gaps(search):
        ends = [plain_through_gaps(search, end) for end in ends]
    ends = sorted(ends, key=lambda e: -e.score)
    if not ends:
        return None
    if search.channel.mean_square(ends[0]) <= RELAYS_FROM:
        return search.keep(ends[0])
    found = [search.widened(e) for e in budget.in_time(ends[:WIDENED])]
    far = search.channel.mean_square(fit) > FAR_FROM_NOISE
    if fit.parameters.has_relays and not far:  # what shows beside another film, and what it may have absorbed
        likely = [beside for beside, *_ in tests.values() if beside.gain > PASSES]
        begin = [test.start for test in sorted(likely, key=lambda test: -test.gain)[:WIDENED]]
        readings = [n for n in others if isinstance(search.effects[n].form, Reading)]
        begin += [start for start in (search.absorbed(fit, search.effects[n]) for n in readings) if start is not None]
        found += [search.beside(fit, start) for start in budget.in_time(begin)]
    sound = [e for e in found if has_meaning(search, e)]
    return max(sound, key=lambda e: e.score) if sound else None


def _one_more_beside(search: ResistanceSearch, fit: ResistanceFit, others: list[str]) -> ResistanceFit | None:
    """The best fit with one more effect, where relays leave nothing: what shows beside them, or does their work."""
    tests = {n: search.score_test(fit, n, FINER) for n in others}
    likely = sorted((n for n in others if tests[n].gain > PASSES), key=lambda n: -tests[n].gain)
    found = [search.beside(fit, tests[n].start) for n in search.budget.in_time(likely[:TRIED])]
    instead = (search.in_their_place(fit, name) for name in search.budget.in_time(others))
    found += [end for end in instead if end is not None]
    sound = [e for e in found if has_meaning(search, e)]
    return max(sound, key=lambda e: e.score) if sound else None


def _improved_last(search: ResistanceSearch, names: frozenset[str], timed: Timed) -> frozenset[str]:
    """Swaps and removals until none is better, delays first. timed: which of them it is."""
    names = timed(search, names)
    for _ in range(3):  # as above; each costs much more
        best = search.fit(names)
        too_much_left = ROUGH if best.parameters.has_relays else FAR_FROM_NOISE
        if len(names) < 2 or search.channel.mean_square(best) > too_much_left:
            return names  # as long as something large is missing, whatever is there may stand in for it
        changed: ResistanceFit | None = None
        for name in search.budget.in_time(sorted(names - search.assumed)):
            fit = search.without(best, name)
            if best.score - fit.score < entry_of(best):
                return _improved_last(search, names - {name}, timed)
            if best.score - fit.score > 0.5 * abs(fit.score) and best.minus_log < 0.55 * search.channel.rows.size:
                continue  # nothing else can do as much and leave nothing (0.5 a row is the noise's own)
            other = _one_more(search, fit, TIMING if name in TIMING else frozenset({name}))
            if other is not None and other.score > (changed or best).score + 1.0:
                changed = other
        if changed is None:
            return names
        names = frozenset(e.name for e in changed.effects)
    return names
