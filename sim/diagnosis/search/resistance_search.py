"""Which effects the last links need, on one path of the plate's temperature."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_basis import ENVELOPES
from sim.diagnosis.fit.film_memory import begun
from sim.diagnosis.fit.film_start import starting_shape, thinned_path
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.search.budget import SEARCHING, Budget
from sim.diagnosis.search.film_mixing import mixed
from sim.diagnosis.search.fit_steps import QUICK_STEPS, RELAY_STEPS, WHOLE_STEPS
from sim.diagnosis.search.starting_sizes import SIZES, starts_of
from sim.diagnosis.search.views import NOTHING, View
from sim.effects.effect import Effect, Reading, Switched, at_the_terminals
from sim.model.film_nodes import FilmNodes

FINER = 7  # sizes looked at before a descent begins
BEGUN = 2  # descents begun, the second where its cost is not much larger
AS_GOOD = 1.2
RELAYS_FROM = 1.02  # mean square residual over noise from which a film of another kind is thought of
WITHIN = 20.0  # log-likelihood below the film's own that a size begins a descent with
RELAY_ROUNDS = 4  # of so many steps, at most, after the first
SETTLED = 0.5  # log-likelihood that another round brings
FEW_READINGS = 500  # with which a fit costs little, and on its way tells other readings the worse the fewer there are
COMPARED_BELOW = 1.5  # mean square residual over noise below which log-likelihoods of some units matter
PAIR_SIZES = 7  # of each of two effects: 49 pairs
TWO_AT_ONCE = 8.0  # log-likelihood from which two effects at once are tried
SOME_OF_IT = 0.3  # of the work of relays, from which an effect is followed to the end in their place
UNDERSTOOD = 30.0  # mean square residual over noise below which the memory at the first row is looked for anew
RESHAPED_FROM = 1.2  # mean square residual over noise from which the envelopes are searched for anew


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """How much an effect may bring: gain of the log-likelihood, and the values to begin from."""

    gain: float
    start: Switched


@dataclass(frozen=True, eq=False)
class KnownShape:
    """The envelopes that a global search found: shape (4,), at these nodes, in this output (rows,)."""

    nodes: FilmNodes
    output: Array
    shape: Array

    def serves(self, nodes: FilmNodes, output: Array, channel: ResistanceChannel) -> bool:
        """Whether it would be found again: the same film, and an output that differs by less than the noise."""
        apart = channel.over((output - self.output)[channel.rows])
        return nodes.same_film(self.nodes) and float(np.mean(apart**2)) < 1.0


@dataclass(frozen=True, eq=False)
class ResistanceSearch:
    """Fits of the last links. assumed: the effects that the user knows are there; budget: of time, for the search. What
    was found so far: fits, the best by the names of their effects; shapes, the envelopes last searched for globally;
    views, of the fits last tested, one with relays and the same without, which are the last pair in bare; restarted,
    the effects whose fit was begun again (`restarts`)."""

    channel: ResistanceChannel
    effects: dict[str, Effect]
    base: FilmParameters
    assumed: frozenset[str] = frozenset()
    budget: Budget = field(default_factory=Budget)
    fits: dict[frozenset[str], ResistanceFit] = field(default_factory=dict)
    shapes: deque[KnownShape] = field(default_factory=lambda: deque(maxlen=1))
    restarted: set[frozenset[str]] = field(default_factory=set)
    views: deque[View] = field(default_factory=lambda: deque(maxlen=2), init=False)
    bare: deque[tuple[ResistanceFit, ResistanceFit]] = field(default_factory=lambda: deque(maxlen=1), init=False)

    def fit(self, names: frozenset[str], near: ResistanceFit | None = None) -> ResistanceFit:
        """The best fit with exactly these effects; `near`: one to begin from."""
        if names in self.fits:
            return self.fits[names]
        if not names:
            return self.keep(self.whole(near.parameters if near is not None else self.base))
        if near is None:
            near = self.fit(names - {min(names)})
        missing = sorted(names - {e.name for e in near.effects})
        if len(missing) == 1:
            return self.finish(self.quick(near, missing[0]))
        kept = [e for e in near.effects if e.name in names]
        kept += [starts_of(self.effects[name], self.channel)[0] for name in missing]
        return self.keep(self.whole(self.channel.extended(near.parameters, kept)))

    def quick(self, near: ResistanceFit, name: str, test: ScoreTest | None = None) -> ResistanceFit:
        """A few steps with one more effect, from the values of the best score test, without relays."""
        test = test or self.score_test(near, name)
        plain = near.plain or near.parameters
        others = [e for e in plain.effects if e.name != name]
        begin = self.starts(plain, others, name, test.start)
        found = [self.channel.descend(start, QUICK_STEPS) for start in begin]
        return max(found, key=lambda fit: fit.score if np.isfinite(fit.score) else -np.inf)

    def finish(self, quick: ResistanceFit) -> ResistanceFit:
        """To the end from a quick fit."""
        return self.keep(self.whole(quick.parameters))

    def without(self, fit: ResistanceFit, name: str) -> ResistanceFit:
        """The best fit without one of a fit's effects, beginning from where the fit is."""
        plain = fit.plain or fit.parameters
        rest = [e for e in plain.effects if e.name != name]
        found = self.whole(self.channel.extended(plain, rest))
        if fit.parameters.has_relays:  # from where the relays are, too
            rest = [e for e in fit.effects if e.name != name]
            wider = self.channel.descend(self.channel.extended(fit.parameters, rest), RELAY_STEPS)
            found = max((found, replace(wider, plain=found.plain)), key=lambda f: f.score)
        return self.keep(found)

    def instead(self, fit: ResistanceFit, name: str, other: str, anew: bool = False) -> ResistanceFit:
        """Another effect in the place of one of a fit's, from the film as it is there: begun without either of them, it
        may end in other envelopes. anew: from envelopes searched for beside each size, kept: where much is left, those
        of the fit were bent to what the wrong effect does, and no descent leads from there to a lag of seconds."""
        bare = (fit.plain or fit.parameters).with_relays(0.0)
        rest = [e for e in bare.effects if e.name != name]
        if not anew:
            return self.channel.descend(self.starts(bare, rest, other)[0], WHOLE_STEPS)
        begun = [self.channel.extended(bare, [*rest, e]) for e in starts_of(self.effects[other], self.channel, FINER)]
        found = [self._reshaped(self.channel.descend(p, 0)) for p in begun]
        best = max(found, key=lambda f: f.score if np.isfinite(f.score) else -np.inf)
        return self.widened(replace(best, plain=best.parameters))

    def keep(self, fit: ResistanceFit) -> ResistanceFit:
        """Remember a fit, if it is the best with its effects."""
        names = frozenset(e.name for e in fit.effects)
        known = self.fits.get(names)
        if known is None or fit.score > known.score:
            self.fits[names] = fit
        return self.fits[names]

    def starts(
        self, plain: FilmParameters, others: list[Switched], name: str, *likely: Switched
    ) -> list[FilmParameters]:
        """Where to begin: of the likely values and those over the range, the ones at which the film fits best with its
        envelopes as they are."""
        sizes, bare = (*likely, *starts_of(self.effects[name], self.channel, FINER)), plain.with_relays(0.0)
        tried = self._best_of([self.channel.extended(bare, [*others, size]) for size in sizes])
        return [p for cost, p in tried if cost <= AS_GOOD * tried[0][0]]

    def _best_of(self, begin: Sequence[FilmParameters]) -> list[tuple[float, FilmParameters]]:
        """Those few at which the film fits best with its envelopes as they are, and the costs."""
        return sorted(((self.channel.point(p, p.x).cost, p) for p in begin), key=lambda found: found[0])[:BEGUN]

    def whole(self, parameters: FilmParameters) -> ResistanceFit:
        """To the end: first as a Prandtl-Ishlinskii film, then with relays where that leaves something."""
        return self._wide(self.plain(parameters))

    def plain(self, parameters: FilmParameters) -> ResistanceFit:
        """To the end as if the film were a Prandtl-Ishlinskii one."""
        fit = self._remembered(self._reshaped(self.channel.descend(parameters.with_relays(0.0), WHOLE_STEPS)))
        return replace(fit, plain=fit.parameters)

    def _remembered(self, fit: ResistanceFit) -> ResistanceFit:
        """The fit, or a better one with another memory at the first row: the one that was found without an effect may
        stand in for a part of it."""
        p = fit.parameters
        if self.channel.mean_square(fit) > UNDERSTOOD:
            return fit
        start = begun(self.channel, p)
        if start == p.start:
            return fit
        other = self.channel.descend(replace(p, start=start), WHOLE_STEPS)
        return other if other.score > fit.score else fit

    def _reshaped(self, fit: ResistanceFit) -> ResistanceFit:
        """The fit, or a better one from envelopes searched for globally at the film's temperatures with its effects, in
        what they leave of the readings: those that were found without them may be far off."""
        channel, p = self.channel, fit.parameters
        if channel.mean_square(fit) < RESHAPED_FROM or p.prior.is_of_relays:
            return fit
        _, nodes = channel.nodes(p, p.x)
        film = channel.output - (fit.shown - fit.film_output)  # as an ohmmeter without its effects would read it
        known = next((shape for shape in self.shapes if shape.serves(nodes, film, channel)), None)
        if known is None:
            thin = thinned_path(nodes, film, channel.fitted, p.start)
            known = KnownShape(nodes, film, starting_shape(thin, channel.basis.curve is not None)[0])
            self.shapes.append(known)
        x = p.x.copy()
        x[:ENVELOPES] = known.shape
        prior = replace(p.prior, weight_dec=self.base.prior.weight_dec)
        other = channel.descend(replace(p, x=x, prior=prior), WHOLE_STEPS)
        return other if other.score > fit.score else fit

    def widened(self, fit: ResistanceFit) -> ResistanceFit:
        """A plain fit with relays, kept."""
        return self.keep(self._wide(fit))

    def beside(self, fit: ResistanceFit, start: Switched, *place_of: str) -> ResistanceFit:
        """One more effect, or one in the place of others, with the film as the fit has it, relays and all, or without
        them if that is as good; kept."""
        others = [e for e in fit.effects if e.name not in (start.name, *place_of)]
        wider = self.channel.descend(self.channel.extended(fit.parameters, [*others, start]), RELAY_STEPS)
        best = replace(wider, plain=wider.parameters.with_relays(0.0))
        if isinstance(start.effect.form, Reading):  # whose work relays can do
            plain = self.channel.descend(wider.parameters.with_relays(0.0), RELAY_STEPS)
            best = replace(max((wider, plain), key=lambda f: f.score), plain=plain.parameters)
        return self.keep(best)

    def in_their_place(self, fit: ResistanceFit, name: str) -> ResistanceFit | None:
        """One more effect from where it does the most of the relays' work: beside a Prandtl-Ishlinskii film if that
        leaves nothing, else beside the fit's relays; kept. None of an effect that does little of it, but for one in the
        reading, of which relays hide that it does."""
        plain = self.quick(fit, name)
        reading, some = isinstance(self.effects[name].form, Reading), self._gone(fit, plain) > SOME_OF_IT
        if not some and not reading:
            return None
        if some:
            plain = self.plain(plain.parameters)
            if self.channel.mean_square(plain) <= RELAYS_FROM:
                return self.keep(plain)
        return self.beside(fit, next(e for e in plain.effects if e.name == name))

    def _without_relays(self, fit: ResistanceFit) -> ResistanceFit:
        """The fit as it was before it had relays; itself where it has none, or was never without."""
        if fit.plain is None or not fit.parameters.has_relays:
            return fit
        if not self.bare or self.bare[0][0] is not fit:
            self.bare.append((fit, self.channel.descend(fit.plain, 1)))
        return self.bare[0][1]

    def _view(self, fit: ResistanceFit) -> View:
        """The fit as every effect's score test sees it."""
        known = next((view for view in self.views if view.fit is fit), None)
        if known is None:
            known = View(self.channel, fit)
            self.views.append(known)
        return known

    def _gone(self, fit: ResistanceFit, plain: ResistanceFit) -> float:
        """Which share of what a fit leaves without its relays another leaves no more: 1 does all of their work."""
        without = self._without_relays(fit)
        return (without.minus_log - plain.minus_log) / max(without.minus_log - fit.minus_log, 1e-30)  # > 0

    def absorbed(self, fit: ResistanceFit, effect: Effect, within: float = WITHIN) -> Switched | None:
        """The size of an effect beside which the film fits about as well as without it, the best; None without one."""
        others = [e for e in fit.effects if e.name != effect.name]
        best, value = None, fit.score - within
        for start in starts_of(effect, self.channel, FINER):
            p = self.channel.extended(fit.parameters, [*others, start])
            evidence = self.channel.point(p, p.x).evidence
            if evidence > value:
                best, value = start, evidence
        return best

    def _wide(self, fit: ResistanceFit) -> ResistanceFit:
        needed = self.channel.mean_square(fit) > RELAYS_FROM and not self.budget.over()
        return self._relayed(fit) if needed else fit

    def _relayed(self, fit: ResistanceFit) -> ResistanceFit:
        """The fit, or a better one with relays."""
        if self.channel.relays:
            wider = self.channel.descend(fit.parameters.with_relays(fit.parameters.prior.first_relay_dec), RELAY_STEPS)
            if self.channel.rows.size < FEW_READINGS:
                wider = self._followed(wider)
            if wider.score > fit.score + SETTLED:  # less is the descent's gain, not theirs
                wider = replace(wider, plain=fit.parameters)
                return wider if self.budget.over(SEARCHING) else mixed(self, wider)
        return fit

    def ended(self, fit: ResistanceFit) -> ResistanceFit:
        """A fit with relays followed to its end, kept: the priors' widths and the envelopes follow each other slowly,
        and what is left on the way (up to 15 of log-likelihood) would be any other fit's evidence."""
        close = fit.parameters.has_relays and self.channel.mean_square(fit) < COMPARED_BELOW
        return self.keep(self._followed(fit) if close else fit)

    def _followed(self, fit: ResistanceFit) -> ResistanceFit:
        """A fit with relays, as far as it goes on gaining."""
        for _ in range(RELAY_ROUNDS):
            again = replace(self.channel.descend(fit.parameters, RELAY_STEPS), plain=fit.plain)
            if again.score < fit.score + SETTLED:
                break
            fit = again
        return fit

    def relayed(self, names: frozenset[str]) -> ResistanceFit:
        """The best fit with exactly these effects, relays tried though little is left."""
        fit = self.fit(names)
        return self.keep(self._relayed(fit)) if not fit.parameters.has_relays else fit

    def score_tests(self, fit: ResistanceFit, names: Sequence[str]) -> dict[str, list[ScoreTest]]:
        """What each effect may bring: seen from the fit, and, where that has relays, from the same without."""
        without = self._without_relays(fit)
        seen = [fit] if without is fit else [fit, without]
        return {name: [self.score_test(f, name) for f in seen] for name in names}

    def score_test(self, fit: ResistanceFit, name: str, sizes: int = SIZES) -> ScoreTest:
        """How much one more effect may bring, the film's linear coefficients and envelopes free (score test)."""
        view, effect = self._view(fit), self.effects[name]
        best, nearest, start = 0.0, -np.inf, starts_of(effect, self.channel)[0]
        starts = starts_of(effect, self.channel, sizes)
        for trial, delta in zip(starts, view.left_of_each(starts).T, strict=True):
            size, along = float(delta @ delta), float(delta @ view.residual)
            if not size > NOTHING or not np.isfinite(size):
                continue
            if along > 0.0 or any(par.signed for par in effect.parameters):
                best = max(best, 0.5 * along * along / size)
            if along - 0.5 * size > nearest:  # what this very size would bring
                nearest, start = along - 0.5 * size, trial
        return ScoreTest(best, start)

    def two_at_once(self, fit: ResistanceFit) -> ResistanceFit | None:
        """The best fit with two more effects of the ohmmeter's terminals: what one bends the other may straighten, so
        that neither shows alone. None where no two pass a score test."""
        names = frozenset(e.name for e in fit.effects)
        others = sorted(n for n in self.effects if n not in names and at_the_terminals(self.effects[n]))
        plain = self._without_relays(fit)
        view, p = self._view(plain), plain.parameters.with_relays(0.0)
        left = {n: [*view.left_of_each(starts_of(self.effects[n], self.channel)).T] for n in others}
        pairs = [(one, two) for one, two in combinations(others, 2) if _pass(view.residual, left[one], left[two])]
        ends = [self._two(p, pair) for pair in pairs]
        return self.keep(self._wide(max(ends, key=lambda end: end.score))) if ends else None

    def _two(self, p: FilmParameters, pair: tuple[str, str]) -> ResistanceFit:
        """A plain fit with these two as well, from the sizes of both at which the film fits best."""
        sizes = product(*(starts_of(self.effects[name], self.channel, PAIR_SIZES) for name in pair))
        begin = self._best_of([self.channel.extended(p, [*p.effects, *two]) for two in sizes])
        best = max((self.channel.descend(trial, WHOLE_STEPS) for _, trial in begin), key=lambda fit: fit.score)
        return replace(best, plain=best.parameters)


def _pass(residual: Array, one: list[Array], two: list[Array]) -> bool:
    """Whether two effects, at some of their sizes, pass a score test together, both with the sign that they have.
    residual; one, two: of each size what it changes; all in the fitted rows, over the noise."""
    for both in (np.stack(columns, axis=1) for columns in product(one, two)):
        if np.all(np.isfinite(both)):
            share = np.linalg.lstsq(both, residual, rcond=1e-6)[0]  # 0 of what does the same
            if np.all(share > 0.0) and 0.5 * float(residual @ (both @ share)) > TWO_AT_ONCE:
                return True
    return False
