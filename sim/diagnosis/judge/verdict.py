"""From selected effects to what may be said: names only where the evidence survives whatever else is going on.

Where a fit with the selected effects leaves nothing, each is worth what the likelihood falls by without it. Where it
leaves something, each has to survive a residual whitened by a discrepancy of its own, and to have explained most of
what was left without it; else what is left is called unexplained, and not forced on the nearest candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.diagnosis.data.misfit import correlated_rows
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.judge.false_alarm import candidates, evidence_for
from sim.diagnosis.judge.held_out_evidence import held_out_evidence, held_out_square
from sim.diagnosis.judge.output_nonlinearity import is_output_nonlinearity, no_other_sharpness_is_better
from sim.diagnosis.judge.plate_kind import NO_KIND, of_no_kind
from sim.diagnosis.judge.smoother_path import LEAST_BEYOND, beyond_a_smoother_path
from sim.diagnosis.search.budget import JUDGING
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.delays import TIMING, of_delays
from sim.diagnosis.search.meaning import BEYOND, LEAST_BESIDE, SMALL, most_of_what_is_met, without_meaning
from sim.diagnosis.search.stepwise import ABSORBS, CHOICE
from sim.diagnosis.search.views import View
from sim.diagnosis.validate.adequacies import adequacies, resistance_residual, temperature_residual
from sim.diagnosis.validate.adequacy import Adequacy
from sim.diagnosis.validate.discrepancy import cosines, whitened_score
from sim.effects.effect import Switched

SURVIVES = 25.0  # whitened log-likelihood that an effect keeps where something is left
BEHIND_UNKNOWN = 300.0  # evidence that a film's or ohmmeter's effect needs behind a plate that is not understood
SPEAKS_AGAINST = 0.1  # share of the evidence that rows which no fit has seen may lose by an effect
BENDS_ITSELF = 40.0  # evidence that a bend needs beside a film of another kind: most bend less by themselves
WEAK = 30.0  # evidence below which they may lose no more than chance lets them
EXPECTED = 0.25  # share of the evidence needed that an effect beside a film of another kind is expected to bring
CHANCE = 2.33  # standard deviations: one real effect in a hundred is refused where the rest predicts as well
SURVIVES_BESIDE = 40.0  # where the effects only together explain most of what the base model leaves
SEEN_BESIDE = 0.1  # share of the evidence that unseen rows have to show
MOST_LEFT_OF_ALL = 0.4
CERTAIN = 100.0  # log-likelihood of an effect beside a little that is left, or of one that is small
LITTLE_LEFT = 0.2  # of the noise's variance
UNSEEN = 2.0  # RMSE over noise on unseen rows from which something is left
UNDERSTOOD = 1.3  # mean square residual over noise there, below which a bend of another film's reading is said
AGAINST = "held-out rows speak against it: log-likelihood"
MAY_DO_AS_MUCH = "something else is left with it, which may do what it seems to do"
SMOOTHS = "a smoother course of the temperature that drives the film does as much, or most of it"
NOT_JUDGED = (0.0, (0.0, "the time was over before it was judged"))
MOST_LEFT = 0.25  # share of the excess that may be left where an effect is named


@dataclass(frozen=True)
class Verdict:
    """names: in order of evidence; evidence: of each; adequacy: of each channel, None where it is missing; refused: why
    an effect that the search had selected is not named; fitted: the names, and the effects that were assumed;
    by_records: those names that further records of the film decided."""

    names: tuple[str, ...]
    evidence: dict[str, float]
    temperature: Adequacy | None
    resistance: Adequacy | None
    refused: dict[str, str]
    fitted: frozenset[str]
    by_records: frozenset[str] = frozenset()

    @property
    def clean(self) -> bool:
        """Whether nothing is left in any channel."""
        return all(a is None or a.clean for a in (self.temperature, self.resistance))


def _whitened(chain: Chain, names: frozenset[str], last: bool) -> float:
    """Score of one channel under a discrepancy."""
    a, b = chain.fits(names)
    if last:
        z, rows = resistance_residual(chain, names)
        assert b is not None
        channel = chain.film_channel(names)
        point = channel.point_of(b)
        free = np.concatenate((point.columns, channel.over(b.jacobian[rows])), axis=1)
    else:
        z, rows = temperature_residual(chain, names)
        assert a is not None
        assert chain.first is not None
        stretch = chain.first.channel.stretch
        begins = np.zeros((rows.size, 0))
        if chain.first.channel.stretches <= 30:
            begins = (stretch[:, None] == np.arange(chain.first.channel.stretches)).astype(np.float64)
            along = np.exp(-np.maximum(np.arange(rows.size)[:, None] - np.argmax(begins, axis=0), 0) / 100.0)
            begins = begins * along
        free = np.concatenate((chain.first.channel.over(a.jacobian[rows]), begins), axis=1)
    z = np.clip(z, -1e4, 1e4)
    return whitened_score(z, free, cosines(rows.astype(np.float64), chain.record.rows))


def judge(chain: Chain, names: frozenset[str], before: Verdict | None = None, why: str = "") -> Verdict:
    """The names that may be said; those assumed are the user's, and stay. before: what was said of more names; why:
    they are fewer now. Where the time is over, what was found of a name with more beside it holds."""
    refused: dict[str, str] = {}
    known: dict[str, tuple[float, tuple[float, str] | None]] = {}
    if before is not None:
        refused = {**before.refused, **dict.fromkeys(before.fitted - names, why)}
        known = {name: (evidence, None) for name, evidence in before.evidence.items()}
    while True:
        temperature, resistance = adequacies(chain, names)
        evidence: dict[str, float] = {}
        failing: dict[str, tuple[float, str]] = {}
        for name in sorted(names - chain.assumed):
            if not chain.budget.over(JUDGING):
                known[name] = _worth(chain, names, name, temperature, resistance)
            evidence[name], found = known.get(name, NOT_JUDGED)
            if found is not None:
                failing[name] = found
        if not failing:
            order = tuple(sorted(evidence, key=lambda n: -evidence[n]))
            return Verdict(order, evidence, temperature, resistance, refused, names)
        weakest = min(failing, key=lambda n: failing[n][0])
        fewer = _without_one(chain, names, weakest)
        refused.update(dict.fromkeys(names - fewer, failing[weakest][1]))
        names = fewer


def _without_one(chain: Chain, names: frozenset[str], weakest: str) -> frozenset[str]:
    """Without the weakest effect; of several that delay what is read of the film, without the one that the others need
    least: each was found beside all of them."""
    fewer = [names - {weakest}]
    if weakest in TIMING and not chain.budget.over(JUDGING):
        fewer += [names - {name} for name in sorted((names & TIMING) - chain.assumed - {weakest})]
    return likeliest_timed(chain, fewer) if len(fewer) > 1 else fewer[0]


def likeliest_timed(chain: Chain, sets: Sequence[frozenset[str]]) -> frozenset[str]:
    """Of sets of effects that differ in which one delays what is read of the film, the likeliest."""
    fits = [fit for fit in (chain.fits(each)[1] for each in sets) if fit is not None]
    return sets[int(np.argmin(of_delays(fits)))]


def _worth(
    chain: Chain, names: frozenset[str], name: str, temperature: Adequacy | None, resistance: Adequacy | None
) -> tuple[float, tuple[float, str] | None]:
    """An effect's evidence; and, where it may not be said, what of it counts and why."""
    rest = names - {name}
    evidence = chain.loses(names, name)
    told = held_out_evidence(chain, names, rest)
    unseen = told.gain if told is not None else None
    least = least_evidence(chain, names, name)
    weak = min(evidence, evidence_by_chance(chain))
    if (all_rows := evidence + (unseen or 0.0)) < least:
        if told is not None and evidence > 0.0 > all_rows:
            return evidence, (weak, f"{AGAINST} {rough(told.gain)}")
        return evidence, (weak, f"it brings {rough(all_rows)} of log-likelihood, a name needs {least:.2g}")
    if told is not None and told.gain < -largest_loss_by_chance(evidence, told.changed):
        return evidence, (weak, f"{AGAINST} {rough(told.gain)}")
    certain = resistance is not None and resistance.clean and evidence >= CERTAIN
    certain = certain and (unseen is None or unseen >= SEEN_BESIDE * evidence)
    if too_small(chain, names, name, certain):
        return evidence, (weak, "its size is not one that is met")
    upstream = name in chain.split(names)[0]
    if not upstream and not _seen_beside_preisach_film(chain, names, name):
        return evidence, (weak, "a film of another kind can do what it does")
    if not _predicts(chain, names, rest, not upstream):
        return evidence, (weak, "held-out rows are predicted far worse than the noise with it")
    if not upstream and temperature is not None and evidence < BEHIND_UNKNOWN:
        if not temperature.clean:
            return evidence, (evidence, "the plate's temperature, which drives the film, is not understood")
        if chain.record.early > 0.0:
            return evidence, (evidence, "the plate's temperature between the rows, which drives the film, is not known")
    beyond = beyond_a_smoother_path(chain, names, name)
    if beyond is not None and beyond < LEAST_BEYOND:
        return evidence, (min(weak, beyond), SMOOTHS)
    if is_output_nonlinearity(chain.effects[name]) and not _film_is_explained(chain, names, resistance):
        return evidence, (weak, "the film is not understood, and may bend its output itself")
    left = temperature if upstream else resistance
    if left is None or left.clean:
        return evidence, None
    if upstream and chain.first is not None and chain.first.channel.misfit > 1.0:
        if of_no_kind(chain, names):
            return evidence, (weak, NO_KIND)
        if unseen is None:  # the likelihood knows of what is left, and other records judge
            return evidence, None
        value, needed = evidence * _share_that_counts(chain, names), evidence_by_chance(chain)
    else:
        value, needed = _whitened(chain, names, not upstream) - _whitened(chain, rest, not upstream), SURVIVES
    now, before = _excess(chain, names, not upstream), _excess(chain, rest, not upstream)
    seen = unseen is None or unseen >= SEEN_BESIDE * evidence
    alone = now <= MOST_LEFT * before or (now <= LITTLE_LEFT and value >= CERTAIN and seen)
    bare = _excess(chain, chain.assumed, not upstream)
    together = now <= MOST_LEFT_OF_ALL * bare and value >= SURVIVES_BESIDE and seen
    if value < needed or not (alone or together):
        return evidence, (min(value, evidence), MAY_DO_AS_MUCH)
    return min(evidence, value), None


def largest_loss_by_chance(evidence: float, changed: float) -> float:
    """The largest held-out log-likelihood loss that is consistent with chance, for an effect that changes these rows by
    so much (sum of squares over the noise's); with much evidence, a share of it."""
    chance = CHANCE * float(np.sqrt(changed + 0.5))
    return max(chance, SPEAKS_AGAINST * evidence) if evidence >= WEAK else chance


def least_evidence(chain: Chain, names: frozenset[str], name: str) -> float:
    """What an effect has to bring, in all rows: more where the film is of another kind, and may look like it."""
    of_the_class = name in chain.split(names)[0] or is_prandtl_ishlinskii(chain, names)
    effect = chain.effects[name]
    choosy = any(p.choices for p in effect.parameters)
    if is_output_nonlinearity(effect) and chain.preisach_evidence(names) >= ABSORBS:
        return BENDS_ITSELF
    least = evidence_by_chance(chain)
    return least if of_the_class else max(least, ABSORBS + choosy * CHOICE)


def evidence_by_chance(chain: Chain) -> float:
    """The evidence that noise alone reaches for some effect in the chosen share of records."""
    return evidence_for(chain.false_alarm, candidates(chain.searched))


def is_prandtl_ishlinskii(chain: Chain, names: frozenset[str]) -> bool:
    """Whether the film needs no relays beside its play operators, or there is none."""
    b = chain.fits(names)[1]
    return b is None or not b.parameters.has_relays


def _film_is_explained(chain: Chain, names: frozenset[str], left: Adequacy | None) -> bool:
    """Whether a film of another kind leaves no structure, and a mean square of held-out residuals over the noise below
    `UNDERSTOOD`."""
    if is_prandtl_ishlinskii(chain, names):
        return True
    unseen = held_out_square(chain, names, True)
    return (unseen is None or unseen < UNDERSTOOD) and (left is None or left.clean)


def _seen_beside_preisach_film(chain: Chain, names: frozenset[str], name: str) -> bool:
    """Whether the film without the effect cannot do most of it, as far as this is seen from its fit: evidence that is
    many times what the effect can be expected to bring is not the effect's, but of two fits of a film of another kind.
    Beside a film of the class it is the simpler film that counts. Nor may a film that bends its own output do better.
    """
    rest = names - {name}
    b, without = chain.fits(names)[1], chain.fits(rest)[1]
    if b is None or without is None or is_prandtl_ishlinskii(chain, names):
        return True
    effect = next(e for e in b.effects if e.name == name)
    if View(chain.film_channel(rest), without).expected(effect) < EXPECTED * ABSORBS:
        return False
    return no_other_sharpness_is_better(chain.last(chain.split(names)[0]), b, without, name)


def _predicts(chain: Chain, names: frozenset[str], rest: frozenset[str], last: bool) -> bool:
    """Whether unseen rows are told to about their noise, or most of what they lack is what the effect gives."""
    after, before = (held_out_square(chain, group, last) for group in (names, rest))
    if after is None or before is None or after < UNSEEN * UNSEEN:
        return True
    return after - 1.0 <= MOST_LEFT * (before - 1.0)


def too_small(chain: Chain, names: frozenset[str], name: str, certain: bool) -> bool:
    """Whether an effect's size is without physical meaning: see `without_meaning`. Beside a film of another kind small
    sizes stand in for what the film lacks; certain: that nothing is left with it, and that unseen rows show it."""
    plain = certain or is_prandtl_ishlinskii(chain, names) or name in chain.split(names)[0]
    least = SMALL if plain else LEAST_BESIDE
    for fit in chain.fits(names):
        for e in fit.effects if fit is not None else ():
            if e.name == name:
                beyond = BEYOND if chain.first is None else min(BEYOND, most_of_what_is_met(chain.first.channel.misfit))
                return without_meaning(Switched(chain.effects[name], e.par), chain.record.interval_s, beyond, least)
    return False


def _share_that_counts(chain: Chain, names: frozenset[str]) -> float:
    """Of evidence about the plate beside what nothing explains: the fits count each row for as much as leaves thirty
    independent ones, whatever is left, for the sake of what is known beforehand (`sim.diagnosis.data.misfit`); a name
    counts it for what it is worth beside all that is left."""
    assert chain.first is not None
    z, _ = temperature_residual(chain, names)
    return min(chain.first.channel.misfit / (float(np.mean(z * z)) * correlated_rows(z)), 1.0)


def _excess(chain: Chain, names: frozenset[str], last: bool) -> float:
    """Mean square residual over the noise's, less one."""
    z, _ = resistance_residual(chain, names) if last else temperature_residual(chain, names)
    return max(float(np.mean(z * z)) - 1.0, 0.0)
