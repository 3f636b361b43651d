"""Which effects the first links need: the base fit from many starts, then effects forward, swapped and backward."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.misfit import misfit_of
from sim.diagnosis.data.record import Record
from sim.diagnosis.fit.temperature_channel import TemperatureChannel, TemperatureFit
from sim.diagnosis.search.budget import Budget
from sim.diagnosis.search.views import NOTHING as NO_CHANGE
from sim.diagnosis.search.views import FirstView
from sim.effects.effect import Command, Effect, Filter, HeatFlow, Switched, jumps, switched, with_pinned
from sim.inference.plate.starts import Stretch, rough_balances
from sim.model.recorded import driven_rows

ROUGH_STEPS = 12  # of a plate's start, of which the best goes on
EXCHANGED_STEPS = 40  # of a fit that is compared with others, and has to have ended
BEGUN_STEPS, ENDED_STEPS = 30, 60  # of several effects begun at once: until the starts differ; of the best, to its end
FAR_STEPS = 10  # of all else, at values all over the range
BESIDE_STEPS, WALK_STEPS, CLOSE_STEPS = 4, 6, 15  # of all else: beside the best value, in the next cell, at the end
ADDED_STEPS, REMOVED_STEPS, NOTHING_STEPS = 10, 40, 30  # of a fit with one effect more, one less, one of no size
OUTSIDE = 0.3, 3.0  # times the least and the largest size met, between which a search looks
SMALL_SHARE = 0.03  # of a starting value: there a change is linear in the size
TELLS = 3.0  # log-likelihood from which the readings tell which of two lags is the thermometer's: 20 to 1
BEYOND = 3.0  # times the largest lag met up to which a plate may be taken for a thermometer
WORSE_ON_END = 6  # cells that end a walk
SEARCHED = 28  # values that a search looks at
APART, DISTINCT = 1.001, 1.000001  # ratio of two jumps that are not one: of a search, and of its last steps
LEFT = 1.05  # mean square residual over noise
MISFIT = 3.0  # from which a likelihood is one beside what nothing explains; of a clean record it is 1 to 1.5
NOTHING = 0.05  # of the smallest size met
TOGETHER = 0.35, 0.75  # the same of several effects at once
BOTH = 0.2, 0.8  # where in the range of sizes a descent begins, on a log scale


@dataclass(frozen=True, eq=False)
class TemperatureSearch:
    """Fits of the first links. assumed: the effects that the user knows are there; budget: of time, for the search.
    fits: what was found so far, the best by the names of their effects; views: of the fit that was tested last."""

    channel: TemperatureChannel
    effects: dict[str, Effect]
    base: TemperatureFit
    assumed: frozenset[str] = frozenset()
    budget: Budget = field(default_factory=Budget)
    fits: dict[frozenset[str], TemperatureFit] = field(default_factory=dict)
    views: deque[FirstView] = field(default_factory=lambda: deque(maxlen=1), init=False)

    def fit(self, names: frozenset[str], near: TemperatureFit | None = None) -> TemperatureFit:
        """The best fit with exactly these effects; `near`: one with all but one of them to begin from."""
        if names in self.fits:
            return self.fits[names]
        if not names:
            return self.keep(self.channel.descend(self.base.parameters))
        begin = [near] if near is not None else [self.fit(names - {name}) for name in sorted(names)]
        if self.channel.misfit > 1.0:
            begin += [
                fit for key, fit in self.fits.items() if key < names and len(names - key) == 1 and fit is not near
            ]
        found = [self._added(fit, name) for fit in begin for name in sorted(names - {e.name for e in fit.effects})]
        if self.channel.misfit > 1.0 and not any(jumps(self.effects[name]) for name in names):
            found += self._begun_together(names)
        return self.keep(self._in_better_order(min(found, key=lambda fit: fit.minus_log)))

    def keep(self, fit: TemperatureFit) -> TemperatureFit:
        """Remember a fit, if it is the best with its effects."""
        names = frozenset(e.name for e in fit.effects)
        known = self.fits.get(names)
        if known is None or fit.minus_log < known.minus_log:
            self.fits[names] = fit
        return self.fits[names]

    def _begun_together(self, names: frozenset[str]) -> list[TemperatureFit]:
        """Descents from the plate alone with all of them at once: one by one the first takes what is the others'."""
        found = []
        for shares in itertools.product(TOGETHER, repeat=min(len(names), 2)):
            effects = []
            for k, name in enumerate(sorted(names)):
                share = shares[min(k, len(shares) - 1)]
                sizes = [p.smallest * (p.largest / p.smallest) ** share for p in self.effects[name].parameters]
                effects.append(switched(self.effects[name], with_pinned(self.effects[name], sizes)))
            begin = self.channel.awakened(self.channel.extended(self.base.parameters, effects))
            found.append(self.channel.descend(begin, BEGUN_STEPS))
        best = min(found, key=lambda fit: fit.minus_log)
        return [self.channel.descend(best.parameters, ENDED_STEPS)]

    def walked(self, names: frozenset[str]) -> None:
        """Look again for an effect whose cost jumps, where something is left: found without the others it may be some
        cells off, and no descent leaves its cell."""
        fit = self.fit(names)
        for found in fit.effects:
            effect = self.effects[found.name]
            if jumps(effect) and 2.0 * fit.minus_log > LEFT * self.channel.rows.size:
                fit = self._walked(fit, effect)
        self.keep(fit)

    def without(self, fit: TemperatureFit, name: str) -> TemperatureFit:
        """The best fit without one of a fit's effects, beginning from where the fit is."""
        rest = [e for e in fit.effects if e.name != name]
        return self.keep(self.channel.descend(self.channel.extended(fit.parameters, rest), REMOVED_STEPS))

    def _added(self, fit: TemperatureFit, name: str) -> TemperatureFit:
        effect = self.effects[name]
        if jumps(effect):
            return self._searched(fit, effect)
        found = [self._descend(fit, switched(effect, start), ADDED_STEPS) for start in starting_values(effect, fit)]
        best = min(found, key=lambda trial: trial.minus_log)
        best = self.channel.descend(best.parameters, ENDED_STEPS)
        if best.minus_log > fit.minus_log:  # nothing found that is better: begin where the effect is next to nothing
            nothing = [NOTHING * p.smallest for p in effect.parameters]
            if effect.inverse:
                nothing[0] = effect.parameters[0].largest / NOTHING
            begin = switched(effect, with_pinned(effect, nothing))
            other = self.channel.descend(self._descend(fit, begin, ADDED_STEPS).parameters, NOTHING_STEPS)
            best = min((best, other), key=lambda trial: trial.minus_log)
        return best

    def _in_better_order(self, fit: TemperatureFit) -> TemperatureFit:
        """The better of a fit and the one with the plate's time constant and the thermometer's in each other's place;
        where the readings do not tell, as of a heater that begins at rest, that with the faster thermometer."""
        for effect in fit.effects:
            other = self.exchanged(fit, effect)
            if other is None:
                continue
            faster = other if float(effect.par[0]) * fit.parameters.plate()[2] > 1.0 else fit
            alike = abs(other.minus_log - fit.minus_log) < TELLS
            fit = faster if alike else min((fit, other), key=lambda one: one.minus_log)
        return fit

    def exchanged(self, fit: TemperatureFit, effect: Switched) -> TemperatureFit | None:
        """The fit with the plate's time constant 1/g and the thermometer's in each other's place: two first-order lags
        in a row show the same in either order, but for what is not linear. None of an effect that is no such lag, or
        where no plate or no thermometer has such a time."""
        plain = isinstance(effect.effect.form, Filter) and [q.name for q in effect.effect.parameters] == ["tau_s"]
        if not plain or effect.effect.parameters[0].choices:
            return None
        p = fit.parameters
        s, r, g, q, ambient = p.plate()
        tau, met = float(effect.par[0]), effect.effect.parameters[0]
        if min(tau, 1.0 / g) < met.smallest or max(tau, 1.0 / g) > BEYOND * met.largest:
            return None
        times = 1.0 / (g * tau)
        driven = [s * times, r * times] if p.kind == "peltier" else [q * times]
        base = [*driven, 1.0 / tau, *(times * c for c in p.inputs_K_per_s.values()), ambient]
        effects = [switched(e.effect, [1.0 / g]) if e is effect else e for e in fit.effects]
        x = np.concatenate(([u.inside(v) for u, v in zip(p.base, base, strict=True)], p.x[len(base) :]))
        return self.channel.descend(self.channel.extended(replace(p, x=x), effects), EXCHANGED_STEPS)

    def _descend(self, fit: TemperatureFit, effect: Switched, steps: int) -> TemperatureFit:
        parameters = self.channel.extended(fit.parameters, [*fit.effects, effect])
        return self.channel.descend(self.channel.awakened(parameters), steps)

    def _searched(self, fit: TemperatureFit, effect: Effect) -> TemperatureFit:
        """An effect whose cost jumps: values over the whole range tried, each with a short descent of all else, then
        neighbours of the best, nearer and nearer."""
        edges = cells(effect, self.channel.record)
        values = np.sqrt(edges[:-1] * edges[1:])
        coarse = np.unique(np.searchsorted(edges, searched_values(effect), side="right") - 1)
        coarse = coarse[(coarse >= 0) & (coarse < values.size)]
        if self.channel.misfit > 1.0:  # there a size stands in for a cause: none beyond what is met
            met = coarse[values[coarse] <= effect.parameters[0].largest]
            coarse = met if met.size else coarse[:1]
        begin = replace(fit, parameters=self.channel.awakened(fit.parameters))
        tried = {int(k): self.held(begin, effect, float(values[k]), FAR_STEPS) for k in coarse}
        at = min(tried, key=lambda k: tried[k].minus_log)
        best = tried[at]
        stride = int(max(np.max(np.diff(coarse), initial=1) // 2, 1))
        while stride:
            for k in (at - stride, at + stride):
                if 0 <= k < values.size and k not in tried:
                    tried[k] = self.held(best, effect, float(values[k]), BESIDE_STEPS)
            near = min((k for k in (at - stride, at, at + stride) if k in tried), key=lambda k: tried[k].minus_log)
            if near == at:
                stride //= 2
            at, best = near, tried[near]
        ended = self.held(best, effect, float(values[at]), CLOSE_STEPS)  # what was far had not come down
        return self._walked(ended, effect)

    def _walked(self, best: TemperatureFit, effect: Effect) -> TemperatureFit:
        """The best of a fit and those in the cells beside its own, as far as they become better."""
        for apart in (APART, DISTINCT):
            edges = cells(effect, self.channel.record, apart)
            for side in (-1, 1):
                worse = 0
                for _, other in self.walk(best, effect, edges, side, WALK_STEPS):
                    worse = 0 if other.minus_log < best.minus_log else worse + 1
                    best = min(best, other, key=lambda fit: fit.minus_log)
                    if worse == WORSE_ON_END:
                        break
        return best

    def walk(
        self, fit: TemperatureFit, effect: Effect, edges: Array, side: int, steps: int
    ) -> Iterator[tuple[int, TemperatureFit]]:
        """From the cell of a fit on to that side, cell by cell: the fit with the effect's value held there, all else
        following from the cell before."""
        value = next(float(e.par[0]) for e in fit.effects if e.name == effect.name)
        k = cell_of(value, edges) + side
        while 0 <= k < edges.size - 1:
            fit = self.held(fit, effect, float(np.sqrt(edges[k] * edges[k + 1])), steps)
            yield k, fit
            k += side

    def held(self, fit: TemperatureFit, effect: Effect, value: float, steps: int) -> TemperatureFit:
        """A fit with the effect's value held."""
        others = [e for e in fit.effects if e.name != effect.name]
        held = Switched(held_effect(effect), np.array([value]))
        return self.channel.descend(self.channel.extended(fit.parameters, [*others, held]), steps)

    def score_test(self, fit: TemperatureFit, name: str) -> float:
        """By how much the log-likelihood may rise with one more effect: a step along its own direction, the other
        unknowns free (score test); of an effect that has to be searched for, the best of its values."""
        effect = self.effects[name]
        form = effect.form
        if jumps(effect):
            values = [[float(v)] for v in searched_values(effect)]
        elif isinstance(form, HeatFlow) and form.own_rate is not None:
            values = starting_values(effect, fit)
        else:
            values = [
                [
                    SMALL_SHARE * v if k == 0 or par.signed else v
                    for k, (v, par) in enumerate(zip(start, effect.parameters, strict=True))
                ]
                for start in starting_values(effect, fit)
            ]
        if not self.views or self.views[0].fit is not fit:
            self.views.append(FirstView(self.channel, fit))
        view, best = self.views[0], 0.0
        for value in values:
            delta = view.left_of(switched(effect, list(value)))
            size = float(delta @ delta)
            if size > NO_CHANGE and np.isfinite(size):
                best = max(best, 0.5 * float(delta @ view.residual) ** 2 / size)
        return best


def beside_misfit(search: TemperatureSearch, names: frozenset[str]) -> TemperatureSearch | None:
    """A search that weighs the rows by what the fit with these effects leaves that nothing explains, its fits begun
    anew from the plate alone; None where that fit leaves nothing."""
    channel = search.channel
    driven = driven_rows(channel.record, channel.record.joined)[channel.rows]
    misfit = misfit_of(channel.residual(search.fit(names))[driven])
    if misfit < MISFIT:
        return None
    channel = channel.with_misfit(misfit)
    base = channel.descend(search.base.parameters)
    return replace(search, channel=channel, base=base, fits={})


def cells(effect: Effect, record: Record, apart: float = APART) -> Array:
    """The edges between which a parameter's value makes no difference to this record, rising, and as far apart."""
    parameter, form = effect.parameters[0], effect.form
    assert isinstance(form, Command)
    assert form.jumps is not None
    assert record.current_A is not None
    low, high = OUTSIDE[0] * parameter.smallest, OUTSIDE[1] * parameter.largest
    jumps = np.unique(form.jumps(record.current_A))
    edges = [low]
    for jump in jumps[(jumps > low) & (jumps < high)]:
        if jump > apart * edges[-1]:
            edges.append(float(jump))
    return np.array([*edges, high])


def cell_of(value: float, edges: Array) -> int:
    """The cell that a value lies in."""
    return int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, edges.size - 2))


def searched_values(effect: Effect) -> Array:
    """The values of an effect that has to be searched for."""
    parameter = effect.parameters[0]
    return np.geomspace(OUTSIDE[0] * parameter.smallest, OUTSIDE[1] * parameter.largest, SEARCHED)


def held_effect(effect: Effect) -> Effect:
    """The same effect with parameters that no descent moves."""
    if all(p.choices for p in effect.parameters):
        return effect
    parameters = tuple(p if p.choices else replace(p, choices=(p.smallest, p.largest)) for p in effect.parameters)
    return replace(effect, parameters=parameters)


def starting_values(effect: Effect, fit: TemperatureFit | None = None) -> list[list[float]]:
    """Where descents for an effect begin: within the sizes met, of both signs where it has one."""
    if any(p.signed for p in effect.parameters):
        # a third of the geometric mean, of both signs: a descent grows it where it is larger
        middle = [0.3 * (p.smallest * p.largest) ** 0.5 for p in effect.parameters]
        other = [-v if p.signed else v for v, p in zip(middle, effect.parameters, strict=True)]
        return [with_pinned(effect, middle), with_pinned(effect, other)]
    starts = [[float(p.smallest * (p.largest / p.smallest) ** share) for p in effect.parameters] for share in BOTH]
    if fit is not None and isinstance(effect.form, HeatFlow) and effect.name == "radiative_loss":
        g = fit.parameters.plate()[2]
        # shares of the conductance g; 4 T_a^3 at 310 K is 1.2e8 K^3
        starts = [[share * g / 1.2e8] for share in (0.05, 0.5)]
    return [with_pinned(effect, start) for start in starts]


def base_fit(channel: TemperatureChannel, record: Record, kinds: Sequence[str] = ("peltier",)) -> TemperatureFit:
    """The plate alone, from the balance integrated over windows and from typical plates; of several kinds the one that
    fits best."""
    assert record.current_A is not None
    stretches = []
    edges = [*record.first_rows.tolist(), record.rows]
    for first, last in itertools.pairwise(edges):
        used = record.temperature_used[first:last]
        if np.sum(used) >= 3:  # readings, that a balance can be integrated over
            part = slice(first, last)
            stretches.append(Stretch(record.time_s[part], record.current_A[part], record.temperature_degC[part], used))
    best: TemperatureFit | None = None
    for kind in kinds:
        if best is not None and 2.0 * best.minus_log <= LEFT * channel.rows.size:
            break  # one that leaves nothing needs no other
        found: list[TemperatureFit] = []
        for rough in rough_balances(stretches, "peltier" if kind == "peltier" else "heater"):
            s, r, g, q, ambient = (float(v) for v in rough)
            ambient = min(max(ambient, -20.0), 80.0)  # of any room in which a fit may begin
            s, r, g = max(s, 1e-6), max(r, 1e-5), max(g, 1e-5)  # far below any plate's: a balance may have them < 0
            base = [s, r, g, ambient] if kind == "peltier" else [q, g, ambient]
            found.append(channel.descend(channel.start(kind, np.array(base)), ROUGH_STEPS))
        fit = channel.descend(min(found, key=lambda fit: fit.minus_log).parameters, ENDED_STEPS)
        best = fit if best is None or fit.minus_log < best.minus_log else best
    assert best is not None
    return best
