"""Search for the effects of a record: add, drop and exchange, all at one price (`sim.inference.evidence.price`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.candidates import Start, is_sizeable, possible, scores, starts
from sim.diagnosis.intervals import LESS_LIKELY, Jumps
from sim.effects.effect import Effect, at_the_terminals, jumps
from sim.inference.evidence import FALSE_ALARM, price
from sim.inference.joint.films import PIFilm
from sim.inference.joint.likelihood import Fit, Module
from sim.inference.joint.starts import (
    evidence_of_film,
    in_domains,
    remembered,
    restarted,
    with_other_envelopes,
    with_pi_film,
    with_plate_anew,
    with_preisach_film,
)
from sim.inference.noise import ChannelNoise, Metric, estimate
from sim.inference.nuisance import WORTH

TRIED: Final = 5  # candidates that are fitted in full at each stage: true ones are nearly always among the first three
SAME: Final = 0.6  # of the best promise of an effect: linear ones promise the same from any size
FINISHED: Final = 3  # of these that are fitted to the end
FIRST_STEPS: Final = 6  # of a first fit
TURNS: Final = 4  # of searching a jumping parameter and following with all others
SAME_LIKELIHOOD: Final = 0.5  # less than any interval is made of
STARTS_EACH: Final = 2  # of one candidate: an effect's cost may have several minima
FAR_BEHIND: Final = 0.1  # share of the best score, below which a candidate waits for the next stage
BEHIND: Final = 0.5  # share of the best gain, below which a first fit is not finished
PROMISING: Final = 0.2  # share of its price that a score must promise: far from its size it is 3 to 5 times short
MOST_EFFECTS: Final = 5  # more cannot be told apart in one record
PARTS: Final = ((50, 4), (100, 8))  # of the plane of a film in domains: as many as a few seconds can compute
IMITATED: Final = 0.02  # of what leads or a shunt do alone: 2 % of log R is the least by which films add up otherwise
LEFT_SHARE: Final = 0.35  # of the white noise: a smaller discrepancy is the fit's own discretization


@dataclass
class Search:
    """Sets of effects of one record and their fits. say: takes a line of progress; assumed: effects that are there,
    whatever the record shows; false_alarm: the share of records without any effect that may be given a name; over: the
    time for the search has passed; table: the fits; films: the sets that were tried with a film of another kind."""

    effects: Sequence[Effect]
    say: Callable[[str], None] = lambda text: None
    assumed: frozenset[str] = frozenset()
    false_alarm: float = FALSE_ALARM
    over: Callable[[], bool] = lambda: False
    table: dict[frozenset[str], Fit] = field(default_factory=dict)
    films: set[frozenset[str]] = field(default_factory=set)

    @property
    def known(self) -> dict[str, Effect]:
        """The effects by name."""
        return {effect.name: effect for effect in self.effects}

    def cost_of(self, fit: Fit, effects: Sequence[Effect]) -> float:
        """The price of some effects."""
        rows = fit.joint.rows_K.size + fit.joint.rows_dec.size
        priced = [e for e in effects if e.name not in self.assumed]
        return sum(price(len(e.parameters), rows, len(self.effects), self.false_alarm) for e in priced)

    def value(self, fit: Fit) -> float:
        """Log-likelihood less the price of the effects, and what the parameters of the module cost."""
        rows = fit.joint.rows_K.size + fit.joint.rows_dec.size
        of_module = 0.5 * fit.joint.module.parameters * math.log(rows)
        return fit.log_likelihood - self.cost_of(fit, fit.effects) - of_module

    def worth_of_film(self, fit: Fit) -> float:
        """Evidence of the film's form, less the price of the effects."""
        return evidence_of_film(fit) - self.cost_of(fit, fit.effects)

    def sizeable(self, fit: Fit, effects: Sequence[Effect]) -> bool:
        """Whether some of a fit's effects have sizes that mean something."""
        values = fit.values()
        return all(is_sizeable(e, list(values[e.name].values())) for e in effects if e.name not in self.assumed)

    def keep(self, fit: Fit) -> Fit:
        """Put a fit into the table, if all sizes mean something."""
        key = frozenset(e.name for e in fit.effects)
        if not self.sizeable(fit, fit.effects):
            return fit
        if key not in self.table or self.table[key].log_likelihood < fit.log_likelihood:
            self.table[key] = fit
        return fit

    def add(self, fit: Fit, among: Callable[[Effect], bool] = lambda effect: True, worth: float = 0.0) -> Fit | None:
        """The best fit with one effect more. among: which effects are tried; worth: the log-likelihood that it has to
        gain at least."""
        have = {e.name for e in fit.effects}
        effects = [e for e in possible(self.effects, fit.joint) if e.name not in have and among(e)]
        tried: list[Fit] = []
        for metric in self.metrics(fit):
            at = fit.at if metric is fit.metric else fit.joint.solve(fit.at.x, metric, fit.at.own)
            ranked = scores(fit, effects, metric, at)
            # what explains a residual without a discrepancy has to gain what the discrepancy does
            stands_for = fit.log_likelihood - fit.joint.log_likelihood(at, metric)
            for start in self.promising(ranked, fit, max(stands_for, 0.0) + worth):
                tried.append(self.fitted(fit, start.scaled(), metric))
                gain = tried[-1].log_likelihood - fit.log_likelihood
                gained = f"log-likelihood gain {gain:.0f}" if gain > 0.0 else "no gain"
                self.say(f"tried {described(start.effect, tried[-1])}: {gained}")
        best: Fit | None = None
        for first in sorted(tried, key=self.value, reverse=True)[:FINISHED]:
            if best is not None and self.gain(first, fit) < BEHIND * self.gain(best, fit):
                break
            again = self.finished(first)
            best = again if best is None or (again and self.value(again) > self.value(best)) else best
        return best

    def promising(self, ranked: Sequence[Start], fit: Fit, stands_for: float) -> list[Start]:
        """The few starts that are worth a full fit. stands_for: log-likelihood that they have to make up for."""
        chosen: list[Start] = []
        best = {start.effect.name: start.promised for start in reversed(ranked)}
        # what promises the same from several sizes is fitted from the nearest one
        near = [start for start in ranked if start.promised > SAME * best[start.effect.name]]
        near.sort(key=lambda start: abs(math.log(abs(start.amplitude) + 1e-9)))
        rest = [start for start in ranked if start.promised <= SAME * best[start.effect.name]]
        for start in sorted([*near, *rest], key=lambda start: -best[start.effect.name]):
            name = start.effect.name
            same = sum(s.effect.name == name for s in chosen)
            names = {s.effect.name for s in chosen}
            least = max(FAR_BEHIND * ranked[0].promised, PROMISING * (self.cost_of(fit, [start.effect]) + stands_for))
            if start.promised < least or same >= (STARTS_EACH if start.free > 1 else 1):
                continue
            if same == 0 and len(names) >= TRIED:
                continue
            chosen.append(start)
        return chosen

    @staticmethod
    def metrics(fit: Fit) -> list[Metric]:
        """The two ends of what the discrepancy may be: as estimated, and none, as if one effect explained it all. A
        slow discrepancy hides a slow effect from the first."""
        channels = fit.metric.channels[not fit.metric.simulated :]
        large = any(c.noise.slow > c.noise.white and not c.of_instrument for c in channels)
        return [fit.metric, fit.metric.without_slow()] if large else [fit.metric]

    def fitted(self, fit: Fit, start: Start, metric: Metric) -> Fit:
        """A first fit with a start's effect: one round."""
        joint = fit.joint.having((*fit.effects, start.effect))
        x = joint.with_effect(joint.from_other(fit.joint, fit.at.x), start.effect, start.values)
        first = joint.fit(x, metric, fit.at.known_own, rounds=1, most=fit.most, steps=FIRST_STEPS, settled=1.0)
        return self.at_best_jump(first, first.effects[-1:])

    def finished(self, first: Fit) -> Fit | None:
        """The fit of a set to its end; None where the last effect's size has no physical meaning."""
        if not math.isfinite(first.log_likelihood):
            return None
        found = first.joint.fit(first.at.x, first.metric, first.at.known_own, most=first.most)
        found = max(found, first, key=lambda f: f.log_likelihood)
        if self.metrics(found)[1:]:
            # a large discrepancy stands in for parameters that are off, and keeps them there
            tight = found.metric.tight()
            again = first.joint.fit(found.at.x, tight, found.at.known_own, most=first.most)
            found = max(found, again, key=lambda f: f.log_likelihood)
        found = self.at_best_jump(found, found.effects)
        return self.keep(found) if self.sizeable(found, found.effects[-1:]) else None

    @staticmethod
    def at_best_jump(fit: Fit, effects: Sequence[Effect]) -> Fit:
        """The fit with those parameters of some effects at whose values the outcome jumps searched for: no descent
        finds them."""
        for effect in [e for e in effects if jumps(e)]:
            for _ in range(TURNS):
                x = Jumps(fit, effect).likeliest()
                again = fit.joint.fit(x, fit.metric, fit.at.known_own, rounds=1, most=fit.most)
                if again.log_likelihood < fit.log_likelihood + SAME_LIKELIHOOD:
                    break
                fit = again
            own, most = fit.at.known_own, fit.most
            again = fit.joint.fit(Jumps(fit, effect).middle(), fit.metric, own, rounds=1, most=most)
            fit = again if again.log_likelihood > fit.log_likelihood - LESS_LIKELY else fit
        return fit

    def assuming(self, fit: Fit, effects: Sequence[Effect]) -> Fit:
        """The fit with effects that are there, each from the likeliest of its starting sizes."""
        for effect in effects:
            joint = fit.joint.having((*fit.effects, effect))
            before = joint.from_other(fit.joint, fit.at.x)
            tried = [joint.with_effect(before, effect, start.values) for start in starts(effect)]
            tried.sort(key=lambda x: joint.solve(x, fit.metric, fit.at.known_own).cost)
            own, most = fit.at.known_own, fit.most
            fits = [joint.fit(x, fit.metric, own, rounds=1, most=most, steps=FIRST_STEPS) for x in tried[:FINISHED]]
            first = max(fits, key=lambda f: f.log_likelihood)
            fit = self.finished(first) or first
        return restarted(fit) if effects and isinstance(fit.joint.film, PIFilm) else fit

    def dropped(self, fit: Fit, name: str) -> Fit:
        """The fit without one of its effects."""
        joint = fit.joint.having([e for e in fit.effects if e.name != name])
        x = joint.from_other(fit.joint, fit.at.x)
        less = self.keep(joint.fit(x, fit.metric, fit.at.known_own, most=fit.most))
        return self.likelier_module(less) if any(e.name == name and e.link == "plate" for e in fit.effects) else less

    def likelier_module(self, fit: Fit) -> Fit:
        """The fit with a module whose Seebeck coefficient and resistance change with temperature, or with one where
        they do not: what bends the heat balance may be either, or an effect."""
        if not fit.joint.driven or fit.joint.kind != "peltier":
            return fit
        other = self.with_module(fit, Module("peltier", not fit.joint.slopes))
        return self.keep(max(fit, other, key=self.value))

    @staticmethod
    def with_module(fit: Fit, module: Module) -> Fit:
        """The fit with another module."""
        joint = fit.joint.having(fit.effects, module=module)
        return joint.fit(joint.from_other(fit.joint, fit.at.x), fit.metric, fit.at.known_own, most=fit.most)

    def without(self, fit: Fit, name: str) -> Fit:
        """The best known fit without one of the effects."""
        known = self.table.get(frozenset(e.name for e in fit.effects if e.name != name))
        return known if known is not None and known.joint.film is fit.joint.film else self.dropped(fit, name)

    def gain(self, more: Fit, less: Fit) -> float:
        """Log-likelihood that one fit gains over another."""
        return more.log_likelihood - less.log_likelihood

    def run(self, fit: Fit) -> Fit:
        """The best set and form of film, from a fit on."""
        self.keep(fit)
        self.say(f"effects so far: {named(fit)}")
        anew, other_film = False, None
        while len(fit.effects) < MOST_EFFECTS + len(self.assumed) and not self.over():
            fit = self.finer(self.enveloped(fit))
            better = self.larger(fit)
            if isinstance(fit.joint.film, PIFilm) and "output" in left_over(fit):
                if better is None and not anew:
                    again, anew = restarted(fit), True
                    better = self.keep(again) if again.log_likelihood > fit.log_likelihood + WORTH else None
                # a film is asked what it is once its temperature is understood
                thermal = better is not None and any(e.before_film for e in better.effects if e not in fit.effects)
                if not thermal:
                    another = self.of_film(self.of_another_kind(fit), better or fit)
                    better, other_film = another or better, another.effects if another else other_film
            elif better is None and other_film not in (None, fit.effects):  # these may be what the other film did
                better, other_film = self.of_film(with_pi_film(fit), fit), None
            if better is None:
                break
            fit = better
            self.say(f"effects so far: {named(fit)}")
        return self.refined(self.exchanged(fit))

    def larger(self, fit: Fit) -> Fit | None:
        """The fit with one effect more, and without those that are then not worth their price; None if none is."""
        found = self.add(fit)
        if found is None or self.gain(found, fit) <= self.cost_of(found, found.effects[-1:]):
            return None
        if is_imitated(found, fit):
            self.say(f"{found.effects[-1].name} is no news: the film may do nearly the same")
            return None
        left = left_over(found)
        if "temperature" in left and found.effects[-1].before_film:
            found = with_plate_anew(found)
        better = self.keep(remembered(found) if "output" in left else found)
        better = self.pruned(self.likelier_module(better) if found.effects[-1].before_film else better)
        went_again = better.effects == fit.effects and better.log_likelihood <= fit.log_likelihood + WORTH
        return None if went_again or not self.sizeable(better, better.effects) else better

    def enveloped(self, fit: Fit) -> Fit:
        """The fit with envelopes of another function, where something is left and that is likelier."""
        if not isinstance(fit.joint.film, PIFilm) or "output" not in left_over(fit):
            return fit
        first = max(with_other_envelopes(fit), key=lambda f: f.log_likelihood)
        other = first.joint.fit(first.at.x, first.metric, first.at.known_own, most=fit.most)
        return self.of_film(other, fit) or fit

    def finer(self, fit: Fit) -> Fit:
        """The fit with the radii of a PI film closer to each other, where something is left and that takes it away."""
        film = fit.joint.film
        if not isinstance(film, PIFilm) or "output" not in left_over(fit) or film.operators == film.finer().operators:
            return fit
        other = self.with_finer_film(fit)
        return fit if "output" in left_over(other) else self.of_film(other, fit) or fit

    def refined(self, fit: Fit) -> Fit:
        """The likeliest set with closer radii of a PI film, if these are likelier and an effect may stand in for them:
        of this one, and of those that may then be as likely."""
        if all(e.before_film for e in fit.effects) or not isinstance(fit.joint.film, PIFilm) or self.over():
            return fit
        fine = self.with_finer_film(fit)
        if self.worth_of_film(fine) <= self.worth_of_film(fit):
            return fit
        least = self.value(fit) - self.gain(fine, fit)
        rivals = [other for other in self.table.values() if other is not fit and self.value(other) > least]
        self.table.clear()
        fits = [self.keep(fine), *(self.keep(self.with_finer_film(other)) for other in rivals)]
        best = self.pruned(max(fits, key=self.value))
        self.say(f"effects with closer radii of the film: {named(best)}")
        return best

    @staticmethod
    def with_finer_film(fit: Fit) -> Fit:
        """The fit with closer radii of its PI film."""
        assert isinstance(fit.joint.film, PIFilm)
        joint = fit.joint.having(fit.effects, fit.joint.film.finer())
        return joint.fit(fit.at.x, fit.metric, fit.at.known_own, most=fit.most)

    def of_another_kind(self, fit: Fit) -> Fit | None:
        """The likeliest fit with a Preisach film, smooth or in domains, with all effects or without those that may
        stand in for the film; None where these were tried before."""
        sets = [fit.effects, tuple(e for e in fit.effects if e.before_film or e.name in self.assumed)]
        fits: list[Fit] = []
        for some in dict.fromkeys(sets):
            if (names := frozenset(e.name for e in some)) in self.films:
                continue
            self.films.add(names)
            fits.append(smooth := with_preisach_film(fit, some))
            for parts in PARTS:
                if "output" in left_over(fits[-1]):
                    fits.append(in_domains(smooth, parts))
                    if self.worth_of_film(fits[-1]) <= self.worth_of_film(fits[-2]):
                        break
        for other in fits:
            self.say(f"tried a Preisach film, effects: {named(other)}")
        return max(fits, key=self.worth_of_film, default=None)

    def of_film(self, other: Fit | None, fit: Fit) -> Fit | None:
        """The fit with another form of film, if that has more evidence; what was known with the one before is
        forgotten then."""
        if other is None or self.worth_of_film(other) <= self.worth_of_film(fit):
            return None
        self.table.clear()
        return self.pruned(self.keep(other))

    def pruned(self, fit: Fit) -> Fit:
        """The fit without effects that are no longer worth their price."""
        while optional := [e for e in fit.effects if e.name not in self.assumed]:
            less = [(self.dropped(fit, e.name), e) for e in optional]
            weakest, effect = min(less, key=lambda pair: self.gain(fit, pair[0]) - self.cost_of(fit, [pair[1]]))
            if self.gain(fit, weakest) >= self.cost_of(fit, [effect]):
                break
            self.say(f"dropped {effect.name}: it gains less than its price")
            fit = weakest
        return fit

    def exchanged(self, fit: Fit) -> Fit:
        """The fit with each effect exchanged for a better one, where there is one, and so with the module's slopes."""
        for effect in fit.effects:
            if effect.name in self.assumed or self.over():
                continue
            left = left_over(fit)  # then one effect may stand in for two
            less, name = self.without(fit, effect.name), effect.name
            if left and not outweighs(fit, less):
                continue  # it gets no name

            def others(effect: Effect, name: str = name) -> bool:
                return effect.name != name

            other = self.add(less, others, self.gain(fit, less) * (0.5 if left else 1.0))
            if other is not None and left:
                pair = self.add(other, others)
                other = max(other, pair, key=self.value) if pair and left_over(pair).keys() < left.keys() else other
            fit = self.exchange(fit, other)
        if fit.joint.slopes and not self.over():
            plain = self.with_module(fit, Module("peltier"))
            fit = self.keep(max(fit, plain, key=self.value))
            fit = self.exchange(fit, self.add(plain, lambda effect: effect.link == "plate"))
        return fit

    def exchange(self, fit: Fit, other: Fit | None) -> Fit:
        """The better of two fits."""
        if other is None or self.value(other) + self.cost_of(other, other.effects) <= self.value(fit) + 1.0:
            return fit
        other = self.pruned(other)  # one effect may do what two did
        if self.value(other) <= self.value(fit) + 1.0:
            return fit
        self.say(f"effects after an exchange: {named(other)}")
        return other


def is_imitated(more: Fit, fit: Fit) -> bool:
    """Return True for leads or a shunt of which a film that is not of the class does all but a small part: how the
    parts of such a film add up, in log R, R or 1/R, is not known, and they bend the readings likewise."""
    joint, effect = fit.joint, more.effects[-1]
    if isinstance(joint.film, PIFilm) or not at_the_terminals(effect):
        return False
    having = joint.having((*joint.effects, effect))
    x = having.with_effect(having.from_other(joint, fit.at.x), effect, list(more.values()[effect.name].values()))
    change = joint.change(fit.at, fit.metric, x, False, having)[joint.rows_K.size :]
    alone = float(np.linalg.norm(change)) / more.metric.channels[1].noise.white
    return math.sqrt(2.0 * max(more.log_likelihood - fit.log_likelihood, 0.0)) < IMITATED * alone


def left_over(fit: Fit) -> dict[str, float]:
    """By channel the discrepancy over the white noise, where it is significant and larger than the fit's own errors."""
    found = {}
    for name, residual, channel in zip(("temperature", "output"), _residuals(fit), fit.metric.channels, strict=False):
        if name == "temperature" and not fit.metric.simulated:
            continue
        noise = channel.noise
        if channel.step > 0.0:  # its likelihood has no discrepancy: it is looked for in the mean
            noise = estimate(residual, channel.readings)
            channel = ChannelNoise(noise, channel.readings)
        own = LEFT_SHARE * noise.white
        if name == "output" and not fit.metric.simulated:  # nobody knows the path better than its thermometer
            error = fit.joint.path_error(fit.at, fit.metric.temperature)
            own = math.hypot(own, float(np.sqrt(np.mean(error**2))))
        if noise.slow <= own:
            continue
        white = channel.without_slow().whitening.log_likelihood(residual)
        significant = channel.whitening.log_likelihood(residual) - white > price(2, residual.size)
        if significant and not channel.of_instrument:
            found[name] = noise.slow / noise.white
    return found


def _residuals(fit: Fit) -> tuple[Array, Array]:
    """Of both channels; of rounded readings the mean of their noise."""
    temperature = fit.metric.temperature
    first = fit.at.white_K * temperature.noise.white if temperature.step > 0.0 else fit.at.residual_K
    return first, fit.at.residual_dec


def outweighs(fit: Fit, less: Fit) -> bool:
    """Return True if an effect takes away more in one of the channels than what is left over there. less: the fit
    without it, so that counted is only what neither the film nor the other parameters do in its place."""
    left = left_over(fit)
    residuals = zip(_simulated(less), _simulated(fit), fit.metric.channels, ("temperature", "output"), strict=False)
    for before, after, channel, key in residuals:
        if not after.size:
            continue
        white = channel.noise.white
        unknown = max(float(np.mean(after**2)) - white**2, 0.0) if key in left else 0.0
        if float(np.mean(before**2) - np.mean(after**2)) > max(unknown, (LEFT_SHARE * white) ** 2):
            return True
    return False


def _simulated(fit: Fit) -> tuple[Array, Array]:
    """Residuals of both channels: the thermometer's where the simulation's error is least."""
    return fit.for_simulation.at.residual_K, fit.at.residual_dec


def described(effect: Effect, fit: Fit) -> str:
    """One of the effects of a fit with its parameters."""
    values = ", ".join(f"{name} {value:.3g}" for name, value in fit.values()[effect.name].items())
    return f"{effect.name} ({values})"


def named(fit: Fit) -> str:
    """The effects of a fit with their parameters, for a line of progress."""
    return ", ".join(described(effect, fit) for effect in fit.effects) or "none"
