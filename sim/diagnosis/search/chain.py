"""The whole chain as one fit: first links and last links, with one score for a set of effects."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sim.diagnosis.data.likelihood import quick_noise
from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.record import Mask, Record, Rows
from sim.diagnosis.data.residual_outliers import strays
from sim.diagnosis.data.segments import off_after_missing_rows
from sim.diagnosis.fit.channel_noise import ohmmeter_noise, thermometer_noise
from sim.diagnosis.fit.film_memory import remembered
from sim.diagnosis.fit.path_estimate import corrected_path, measured_path
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.fit.temperature_channel import TemperatureChannel, TemperatureFit
from sim.diagnosis.search.budget import Budget
from sim.diagnosis.search.film_facts import LEAST_NOISE_DEC, FilmFacts, film_facts, least_noise
from sim.diagnosis.search.joint_fit import Tied, settled, tied
from sim.diagnosis.search.resistance_search import ResistanceSearch
from sim.diagnosis.search.temperature_search import TemperatureSearch, base_fit
from sim.effects.effect import Effect
from sim.model.plate_path import PlatePath

LEAST_NOISE_K = 1e-4  # less than any instrument's: of records without noise, rounding
AGAIN_STEPS = 2  # of a film of the class, on the simulated path
PROMISED = 0.5  # of what relays and a corrected path bring
FALSE_ALARM = 0.01  # of records with nothing in them that may be given a name, where nobody chose another share
SAME_NOISE = 0.06  # relative difference of two estimates of a noise that is none


def temperature_search(
    record: Record,
    fitted: Mask,
    effects: dict[str, Effect],
    kinds: tuple[str, ...] = ("peltier",),
    assumed: frozenset[str] = frozenset(),
    budget: Budget | None = None,
) -> TemperatureSearch:
    """The first links' base fit, weighed by the thermometer's own noise. Its record is without what that fit shows to
    be lone readings. assumed: effects known to be there."""
    used = record.temperature_degC[record.temperature_used]
    rough = max(quick_noise(used), LEAST_NOISE_K)
    if record.step_K > 0.0:
        rough = max(rough, 0.3 * record.step_K)
    white = NoiseModel.white(rough)
    channel = TemperatureChannel(record, fitted, white, record.step_K)
    base = base_fit(channel, record, kinds)
    lone = strays(record.temperature_degC, base.shown_degC, record.temperature_used, 0.5 * record.step_K)
    if lone.size:
        record = record.without(lone, lone[:0])
        channel = TemperatureChannel(record, fitted, white, record.step_K)
        base = channel.descend(base.parameters)
    channel = TemperatureChannel(record, fitted, thermometer_noise(channel, base, LEAST_NOISE_K), record.step_K)
    mine = {n: e for n, e in effects.items() if e.link in ("driver", "plate", "thermometer") and not rounds(e)}
    return TemperatureSearch(channel, mine, base, assumed & mine.keys(), budget or Budget())


def rounds(effect: Effect) -> bool:
    """Whether the effect is a lattice of readings, which is seen and not fitted."""
    return bool(getattr(effect.form, "rounding", False))


def path_of(search: TemperatureSearch, fit: TemperatureFit) -> PlatePath:
    """The plate's temperature that drives the film."""
    channel, record = search.channel, search.channel.record
    rows = np.flatnonzero(record.temperature_used)
    if channel.sigma_K < channel.step_K:
        residual = channel.residual(fit) * channel.sigma_K
        rows = channel.rows
    else:
        residual = record.temperature_degC[rows] - fit.shown_degC[rows]
    return corrected_path(record, fit, residual, rows, channel.noise.correlation)


def resistance_search(
    record: Record,
    path: PlatePath,
    fitted: Mask,
    facts: FilmFacts,
    effects: dict[str, Effect],
    relays: bool = True,
    assumed: frozenset[str] = frozenset(),
    budget: Budget | None = None,
) -> ResistanceSearch:
    """The last links on one path. relays: whether the film may be of another kind; assumed: effects known to be
    there."""
    channel = ResistanceChannel(record, path, fitted, facts.noise, facts.basis, relays)
    mine = {n: e for n, e in effects.items() if e.link in ("film", "ohmmeter")}
    if record.test_current_A is None:
        mine = {n: e for n, e in mine.items() if not getattr(e.form, "heated", False)}
    base = FilmParameters((), facts.shape, facts.start, facts.prior)
    return ResistanceSearch(channel, mine, base, assumed & mine.keys(), budget or Budget())


@dataclass
class Chain:
    """Both ends' searches; either may be missing. record: as it was read, less the readings that a fit has shown to be
    lone. Paths and searches of the last links are kept by the first links' effects. together: whether both channels are
    fitted as one, where the simulated temperature drives the film. asked: the effects beside which relays were tried
    though little is left. assumed: effects that the user knows are there, which no search takes out;
    budget: of time; false_alarm: the share of records with nothing in them that may be given a name."""

    record: Record
    fitted: Mask
    effects: dict[str, Effect]
    curve: bool = True
    relays: bool = True
    first: TemperatureSearch | None = None
    facts: FilmFacts | None = None
    searches: dict[frozenset[str], ResistanceSearch] = field(default_factory=dict)
    together: bool = False
    pairs: dict[frozenset[str], Tied | None] = field(default_factory=dict)
    asked: set[frozenset[str]] = field(default_factory=set)
    assumed: frozenset[str] = frozenset()
    budget: Budget = field(default_factory=Budget)
    false_alarm: float = FALSE_ALARM

    def __post_init__(self) -> None:
        self.as_read = self.record

    def last(self, upstream: frozenset[str]) -> ResistanceSearch:
        """The search of the last links behind these effects of the first ones."""
        if upstream not in self.searches:
            path = measured_path(self.record)
            if self.first is not None:
                path = path_of(self.first, self.first.fit(upstream))
            if self.facts is None:
                self.facts = film_facts(self.record, path, self.fitted, self.curve, self.relays, self.path_K)
                self.record = self.record.without(self.facts.strays[:0], self.facts.strays)
            self.searches[upstream] = resistance_search(
                self.record, path, self.fitted, self.facts, self.effects, self.relays, self.assumed, self.budget
            )
        return self.searches[upstream]

    @property
    def searched(self) -> list[Effect]:
        """The effects among which the searches choose."""
        searches = [self.first, *list(self.searches.values())[:1]]
        return [e for s in searches if s is not None for n, e in s.effects.items() if n not in self.assumed]

    @property
    def path_K(self) -> float:
        """How well the thermometer tells the path that drives the film: of the few numbers that a plate has, each is
        known as well as independent readings tell it. 0 where the path is measured, and errs from row to row."""
        if self.first is None:
            return 0.0
        noise = self.first.channel.noise
        return noise.level * float(np.sqrt((1.0 + noise.correlation) / (1.0 - noise.correlation)))

    def split(self, names: frozenset[str]) -> tuple[frozenset[str], frozenset[str]]:
        """Which effects are on the first links, and which on the last."""
        upstream = frozenset(n for n in names if self.effects[n].link in ("driver", "plate", "thermometer"))
        return upstream, names - upstream

    def fits(self, names: frozenset[str]) -> tuple[TemperatureFit | None, ResistanceFit | None]:
        """The best fits with exactly these effects."""
        pair = self.pair(names)
        return (pair.a, pair.b) if pair is not None else self._one_by_one(names)

    def pair(self, names: frozenset[str]) -> Tied | None:
        """Both channels fitted as one; None where each is fitted for itself."""
        if not self.together or self.first is None or self.record.output is None:
            return None
        if names not in self.pairs:
            upstream, _ = self.split(names)
            a, b = self._one_by_one(names)
            assert a is not None
            assert b is not None
            self.pairs[names] = self._tied(self.last(upstream).channel, a, b)
        return self.pairs[names]

    def _tied(self, channel: ResistanceChannel, a: TemperatureFit, b: ResistanceFit) -> Tied | None:
        """Both fits as one; None where the film is of another kind, or needs another path than the simulated one. A
        film of the class on a path that is a little off looks like one of another kind, or the path as if it had to be
        corrected: there a step over both ends has to promise much of what relays and correction bring."""
        assert self.first is not None
        near = b
        if channel.path is not a.path or b.parameters.has_relays:
            channel = channel.on(a.path)
            near = channel.descend(b.without_relays, AGAIN_STEPS)
        begin = tied(self.first.channel, channel, a, near)
        if begin is None or begin.step()[1] < PROMISED * (b.score - near.score):
            return None
        found = settled(begin)
        return found if found.score >= b.score - a.minus_log else None

    def relays_bring(self, names: frozenset[str]) -> float:
        """Log-likelihood that the last channel's fit with these effects owes to relays; 0 where it has none."""
        b = self.fits(names)[1]
        if b is None or not b.parameters.has_relays:
            return 0.0
        plain = self.film_channel(names).descend(b.without_relays)
        return b.score - plain.score

    def keep(self, names: frozenset[str], pair: Tied) -> None:
        """Remember a pair, if it is the best with its effects."""
        known = self.pair(names)
        if known is None or pair.score > known.score:
            self.pairs[names] = pair

    def followed(self, names: frozenset[str], quick: ResistanceFit) -> None:
        """Follow a fit of some steps to the end, where the known fit with these effects, which may have begun from
        another path, is worse."""
        upstream, _ = self.split(names)
        known = self.fits(names)[1]
        if known is not None and quick.score > known.score:
            self.last(upstream).finish(quick)
            self.pairs.pop(names, None)

    def film_channel(self, names: frozenset[str]) -> ResistanceChannel:
        """The channel that the last links' fit with these effects is of."""
        pair = self.pair(names)
        return pair.last if pair is not None else self.last(self.split(names)[0]).channel

    def _one_by_one(self, names: frozenset[str]) -> tuple[TemperatureFit | None, ResistanceFit | None]:
        upstream, downstream = self.split(names)
        a = self.first.fit(upstream) if self.first is not None else None
        b = None
        if self.record.output is not None:
            search = self.last(upstream)
            if downstream not in search.fits:
                known = [s.fits[downstream] for s in self.searches.values() if downstream in s.fits]
                if known:  # the same effects behind another path: a short way from there
                    near = max(known, key=lambda fit: fit.score)
                    search.keep(search.whole(near.plain or near.parameters))
            b = search.fit(downstream)
        return a, b

    def loses(self, names: frozenset[str], name: str) -> float:
        """By how much the log-likelihood falls without one of the effects, everything else following.

        What an effect of the last links brings may be what a film of another kind does, which one of the class plus the
        effect can be fitted to almost as well: both fits may have relays. The one without it begins from the one with
        it, too, for two fits of such a film may differ by more.
        """
        upstream, downstream = self.split(names)
        if name in downstream:
            self._relayed(names)
            self._relayed(names - {name})
            b = self.fits(names)[1]
            if b is not None and b.parameters.has_relays:
                search = self.last(upstream)
                search.ended(search.without(search.ended(b), name))
        return self.score(names) - self.score(names - {name})

    def _relayed(self, names: frozenset[str]) -> None:
        """Give the film relays where that is better."""
        upstream, downstream = self.split(names)
        b = self.fits(names)[1]
        if names in self.asked or b is None or b.parameters.has_relays:
            return
        self.asked.add(names)
        if self.last(upstream).relayed(downstream).score > b.score:
            self.pairs[names] = None

    def score(self, names: frozenset[str]) -> float:
        """Log-likelihood of both channels, up to a constant of the record."""
        a, b = self.fits(names)
        return (-a.minus_log if a is not None else 0.0) + (b.score if b is not None else 0.0)

    def _without(self, temperature: Rows | None = None, output: Rows | None = None) -> bool:
        """Leave these readings out of the record as it was read; None: those that are left out already. Whether
        anything changed: what a fit with too few effects took for lone comes back."""
        whole, record = self.as_read, self.record
        out_T = np.flatnonzero(whole.temperature_used & ~record.temperature_used)
        out_R = np.flatnonzero(whole.output_used & ~record.output_used)
        new_T, new_R = out_T if temperature is None else temperature, out_R if output is None else output
        if np.array_equal(out_T, new_T) and np.array_equal(out_R, new_R):
            return False
        self.record = whole.without(new_T, new_R)
        return True

    def renoised_first(self, upstream: frozenset[str]) -> bool:
        """Weigh the first channel by the noise that the fit with these effects leaves, without the readings that it
        shows to be lone, in stretches that begin where it shows that a row is missing; whether anything changed."""
        assert self.first is not None
        old, record = self.first, self.record
        fit = old.fit(upstream)
        noise = thermometer_noise(old.channel, fit, LEAST_NOISE_K)
        left = record.temperature_degC - fit.shown_degC
        lone = strays(record.temperature_degC, fit.shown_degC, self.as_read.temperature_used, 0.5 * record.step_K)
        changed = self._without(temperature=lone)
        left = np.where(self.record.temperature_used, left / noise.level, np.nan)
        off = off_after_missing_rows(left, record.time_s, record.first_rows)
        if not changed and not off.size and noise.alike(old.channel.noise, record.temperature_degC[:1], SAME_NOISE):
            return False
        self.as_read, self.record = self.as_read.begun_also(off), self.record.begun_also(off)
        self.fitted = self.fitted | (record.held_out & ~self.record.held_out)
        channel = TemperatureChannel(self.record, self.fitted, noise, record.step_K)
        base = replace(old.base, parameters=channel.in_its_stretches(old.base))
        self.first = TemperatureSearch(channel, old.effects, base, old.assumed, old.budget)
        for key, known in old.fits.items():
            if key <= upstream:
                self.first.fits[key] = channel.descend(channel.in_its_stretches(known), 10)
        return True

    def renoised(self, names: frozenset[str]) -> bool:
        """The same for the last channel, with the memory that fits best beside these effects. What only comes back was
        fitted without being seen: it changes nothing that effects would have to be selected anew for."""
        _, b = self.fits(names)
        upstream, _ = self.split(names)
        if b is None or self.facts is None:
            return False
        noise = ohmmeter_noise(self.searches[upstream].channel, b, LEAST_NOISE_DEC, self.path_K)
        assert self.record.output is not None
        lone = strays(self.record.output, b.shown, self.as_read.output_used, least_noise(noise, self.record.output))
        start = remembered(self.searches[upstream].channel, b.parameters)
        used = self.record.output_used
        same = noise.alike(self.facts.noise, self.record.output[used], SAME_NOISE) and start == self.facts.start
        same = same and not np.any(used[lone])
        if not self._without(output=lone) and same:
            return False
        self.facts = replace(self.facts, noise=noise, start=start)
        self.searches.clear()
        search = self.last(upstream)
        search.keep(search.whole(replace(b.plain or b.parameters, start=start)))
        return not same
