"""The whole chain as one fit: first links and last links, with one score for a set of effects.

A `Chain` is what is known before a search: record, noise, the film's facts, what is assumed. It does not change while
it is searched. What a search finds stands beside it: the best fit so far of each set of effects, from which the next
set's fit begins. Whatever is learned of the record on the way (`sim.diagnosis.search.learned`) gives another chain.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from compensator.thermal.plate import PlateModel
from sim.diagnosis.data.between_rows import MOST
from sim.diagnosis.data.likelihood import quick_noise
from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.path_error import PathError
from sim.diagnosis.data.record import Mask, Record
from sim.diagnosis.data.residual_outliers import outlying_rows
from sim.diagnosis.data.sparse_loop import SparseLoop
from sim.diagnosis.fit.channel_noise import thermometer_noise
from sim.diagnosis.fit.path_estimate import corrected_path, measured_path, measured_path_error, moved_path
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.fit.smoother_path import smoothed
from sim.diagnosis.fit.temperature_channel import TemperatureChannel, TemperatureFit
from sim.diagnosis.search.budget import Budget
from sim.diagnosis.search.film_facts import FilmFacts
from sim.diagnosis.search.joint_fit import JointFit, joint_fit, settled
from sim.diagnosis.search.resistance_search import ResistanceSearch
from sim.diagnosis.search.temperature_search import TemperatureSearch, base_fit
from sim.effects.effect import Effect
from sim.model.plate_path import PlatePath

LEAST_NOISE_K = 1e-4  # less than any instrument's: of records without noise, rounding
OF_STEP = 0.3  # of a step: the deviation of a uniform error
AGAIN_STEPS = 2  # of a Prandtl-Ishlinskii film, on the simulated path
EXPECTED = 0.5  # of what relays and a corrected path bring
SHARE_STEPS, SHARE_STEP = 2, 0.05  # of a share that enters linearly, but for what the plate's numbers make of it
FALSE_ALARM = 0.01  # of records with nothing in them that may be given a name, where nobody chose another share


def temperature_search(
    record: Record,
    effects: dict[str, Effect],
    kinds: tuple[str, ...] = ("peltier",),
    assumed: frozenset[str] = frozenset(),
    budget: Budget | None = None,
) -> TemperatureSearch:
    """The first links' base fit, weighed by the thermometer's own noise. Its record is without what that fit shows to
    be outliers. assumed: effects known to be there."""
    used = record.temperature_degC[record.temperature_used]
    rough = max(quick_noise(used), LEAST_NOISE_K)
    if record.step_K > 0.0:
        rough = max(rough, OF_STEP * record.step_K)
    fitted, white = ~record.held_out, NoiseModel.white(rough)
    channel = TemperatureChannel(record, fitted, white, record.step_K)
    base = base_fit(channel, record, kinds)
    outliers = outlying_rows(record.temperature_degC, base.shown_degC, record.temperature_used, 0.5 * record.step_K)
    if outliers.size:
        record = record.without(outliers, outliers[:0])
        channel = TemperatureChannel(record, fitted, white, record.step_K)
        base = channel.descend(base.parameters)
    if record.early > 0.0:
        channel, base = _share_fitted(channel, base, fitted)
        record = channel.record
    channel = TemperatureChannel(record, fitted, thermometer_noise(channel, base, LEAST_NOISE_K), record.step_K)
    mine = {n: e for n, e in effects.items() if e.before_film and not rounds(e)}
    return TemperatureSearch(channel, mine, base, assumed.intersection(mine), budget or Budget())


def _share_fitted(
    channel: TemperatureChannel, base: TemperatureFit, fitted: Mask
) -> tuple[TemperatureChannel, TemperatureFit]:
    """The plate with what acts before its row fitted as well: on ramps, of which bends say nothing, it is a time by
    which all is late."""
    for _ in range(SHARE_STEPS):
        record, rows, p = channel.record, channel.rows, base.parameters
        moved = replace(record, early=record.early + SHARE_STEP)
        other = TemperatureChannel(moved, fitted, channel.noise, record.step_K)
        column = (other.simulate(p, p.x, p.first_degC)[1] - base.shown_degC) / SHARE_STEP
        columns = np.concatenate((base.jacobian, column[:, None]), axis=1)[rows]
        left = (record.temperature_degC - base.shown_degC)[rows]
        more = float(np.linalg.lstsq(columns, left)[0][-1])
        record = replace(record, early=min(max(record.early + more, 0.0), MOST))
        channel = TemperatureChannel(record, fitted, channel.noise, record.step_K)
        base = channel.descend(p)
    return channel, base


def rounds(effect: Effect) -> bool:
    """Whether the effect is a quantization of readings, which is seen and not fitted."""
    return bool(getattr(effect.form, "rounding", False))


@dataclass(frozen=True, eq=False)
class Found:
    """The fits of the last links and of both ends that were found so far. searches: of the last links, by the first
    links' effects, which give the path; joint: both channels fitted as one, None where each is fitted for itself;
    relayed: the effects beside which relays were tried though little is left; instead: of these effects, one and
    another, the last links' fit with the other in its place."""

    searches: dict[frozenset[str], ResistanceSearch] = field(default_factory=dict)
    joint: dict[frozenset[str], JointFit | None] = field(default_factory=dict)
    relayed: set[frozenset[str]] = field(default_factory=set)
    instead: dict[tuple[frozenset[str], str, str], ResistanceFit] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Chain:
    """What is known of both ends, either of which may be missing, and what was found of them.

    record: less the readings that a fit has shown to be outliers; as_read: with them, None where there are none.
    first: of the first links; facts: of the film (`learned.with_film`). assumed: effects that the user knows are there,
    which no search takes out; budget: of time; false_alarm: the share of clean records that may be given a name.
    curve, relays: whether the film may have a D(T), and be of another kind. together: whether both channels are fitted
    as one, where the simulated temperature drives the film. coloured: the instruments, "thermometer" and
    "ohmmeter", whose noise may have a spectrum of its own. smooth_s: by which the path that drives the film is smoothed
    without delay (`sim.diagnosis.fit.smoother_path`); 0: not at all.
    """

    record: Record
    effects: dict[str, Effect]
    first: TemperatureSearch | None = None
    facts: FilmFacts | None = None
    assumed: frozenset[str] = frozenset()
    budget: Budget = field(default_factory=Budget)
    false_alarm: float = FALSE_ALARM
    as_read: Record | None = None
    curve: bool = True
    relays: bool = True
    together: bool = False
    coloured: frozenset[str] = frozenset()
    smooth_s: float = 0.0
    found: Found = field(default_factory=Found)

    @property
    def sparse(self) -> SparseLoop | None:
        """What is missing where rows lie too far apart on a film's flank to look for its effects and the ohmmeter's."""
        return self.facts.sparse if self.facts is not None else None

    def last(self, upstream: frozenset[str]) -> ResistanceSearch:
        """The search of the last links behind these effects of the first ones."""
        if upstream not in self.found.searches:
            self.found.searches[upstream] = self._search_on(self.path(upstream))
        return self.found.searches[upstream]

    def _search_on(self, path: PlatePath) -> ResistanceSearch:
        record, facts = self.record, self.facts
        assert facts is not None
        channel = ResistanceChannel.of(record, path, ~record.held_out, facts.noise, facts.basis, self.relays)
        base, mine = FilmParameters.of_the_class(facts.shape, facts.start, facts.prior), self._of_the_film
        return ResistanceSearch(channel, mine, base, self.assumed.intersection(mine), self.budget)

    @property
    def _of_the_film(self) -> dict[str, Effect]:
        """The effects of the last links that this record can show."""
        mine = {n: e for n, e in self.effects.items() if not e.before_film}
        known = self.record.test_current_A is not None
        return {n: e for n, e in mine.items() if known or not getattr(e.form, "heated", False)}

    def path(self, upstream: frozenset[str]) -> PlatePath:
        """The plate's temperature that drives the film: simulated with these effects, or measured."""
        path = self._path(upstream)
        return smoothed(path, self.smooth_s) if self.smooth_s > 0.0 else path

    def _path(self, upstream: frozenset[str]) -> PlatePath:
        """As it is told."""
        if self.first is None:
            return measured_path(self.record)
        channel, fit = self.first.channel, self.first.fit(upstream)
        rows, residual = channel.rows, channel.residual(fit) * channel.sigma_K
        if channel.sigma_K >= channel.step_K or channel.noise.wandering is not None:
            rows = np.flatnonzero(channel.record.temperature_used)
            residual = (channel.record.temperature_degC - fit.shown_degC)[rows]
        if (walk := channel.noise.wandering) is not None:
            return moved_path(
                channel.record, fit.path, walk.smoothed(residual, rows, np.full(rows.size, channel.sigma_K))
            )
        return corrected_path(channel.record, fit.path, residual, rows, channel.noise.as_correlated)

    @property
    def searched(self) -> list[Effect]:
        """The effects among which the searches choose."""
        first = self.first.effects if self.first is not None else {}
        last = self._of_the_film if self.facts is not None else {}
        return [e for n, e in (*first.items(), *last.items()) if n not in self.assumed]

    @property
    def unsure(self) -> PathError | float | None:
        """How well the thermometer tells the path that drives the film: of the few numbers that a plate has, each is
        known as well as independent readings tell it (a standard deviation, K). A measured path errs from row to
        row."""
        if self.first is None:
            return measured_path_error(self.record)
        noise = self.first.channel.noise
        return noise.level * float(np.sqrt((1.0 + noise.as_correlated) / (1.0 - noise.as_correlated)))

    def plate(self, names: frozenset[str]) -> PlateModel | None:
        """The plate of the fit with these effects; None without a current."""
        if self.first is None:
            return None
        a, _ = self.fits(names)
        assert a is not None
        return a.parameters.model(self.first.channel.model_error(a))

    def split(self, names: frozenset[str]) -> tuple[frozenset[str], frozenset[str]]:
        """Which effects are on the first links, and which on the last."""
        upstream = frozenset(n for n in names if self.effects[n].before_film)
        return upstream, names - upstream

    def fits(self, names: frozenset[str]) -> tuple[TemperatureFit | None, ResistanceFit | None]:
        """The best fits with exactly these effects."""
        joint = self.joint(names)
        return (joint.a, joint.b) if joint is not None else self._one_by_one(names)

    def joint(self, names: frozenset[str]) -> JointFit | None:
        """Both channels fitted as one; None where each is fitted for itself."""
        if not self.together or self.first is None or self.record.output is None or self.record.early > 0.0:
            return None
        known = self.found.joint
        if names not in known:
            upstream, _ = self.split(names)
            a, b = self._one_by_one(names)
            assert a is not None
            assert b is not None
            known[names] = self._jointly(self.last(upstream).channel, a, b)
        return known[names]

    def _jointly(self, channel: ResistanceChannel, a: TemperatureFit, b: ResistanceFit) -> JointFit | None:
        """Both fits as one; None where the film is of another kind, or needs another path than the simulated one.
        A Prandtl-Ishlinskii film on a path that is a little off looks like one of another kind, or the path as if it
        had to be corrected: there a step over both ends has to be expected to bring much of what relays and correction
        bring."""
        assert self.first is not None
        near = b
        if channel.path is not a.path or b.parameters.has_relays:
            channel = channel.on(a.path)
            near = channel.descend(b.without_relays, AGAIN_STEPS)
        begin = joint_fit(self.first.channel, channel, a, near)
        if begin is None or begin.step()[1] < EXPECTED * (b.score - near.score):
            return None
        found = settled(begin)
        return found if found.score >= b.score - a.minus_log else None

    def preisach_evidence(self, names: frozenset[str]) -> float:
        """Log-likelihood that the last channel's fit with these effects owes to relays; 0 where it has none."""
        b = self.fits(names)[1]
        if b is None or not b.parameters.has_relays:
            return 0.0
        plain = self.film_channel(names).descend(b.without_relays)
        return b.score - plain.score

    def keep(self, names: frozenset[str], fit: JointFit) -> None:
        """Remember a joint fit, if it is the best with its effects."""
        known = self.joint(names)
        if known is None or fit.score > known.score:
            self.found.joint[names] = fit

    def followed(self, names: frozenset[str], quick: ResistanceFit) -> None:
        """Follow a fit of some steps to the end, where the known fit with these effects, which may have begun from
        another path, is worse."""
        known = self.fits(names)[1]
        if known is not None and quick.score > known.score:
            self.last(self.split(names)[0]).finish(quick)
            self.found.joint.pop(names, None)

    def instead(self, names: frozenset[str], name: str, other: str) -> ResistanceFit:
        """Another effect of the last links in the place of one of these, some steps from the film as it is there."""
        key, (upstream, downstream) = (names, name, other), self.split(names)
        if key not in self.found.instead:
            search = self.last(upstream)
            self.found.instead[key] = search.instead(search.fit(downstream), name, other)
        return self.found.instead[key]

    def film_channel(self, names: frozenset[str]) -> ResistanceChannel:
        """The channel that the last links' fit with these effects is of."""
        joint = self.joint(names)
        return joint.last if joint is not None else self.last(self.split(names)[0]).channel

    def _one_by_one(self, names: frozenset[str]) -> tuple[TemperatureFit | None, ResistanceFit | None]:
        upstream, downstream = self.split(names)
        a = self.first.fit(upstream) if self.first is not None else None
        b = None
        if self.record.output is not None:
            search = self.last(upstream)
            if downstream not in search.fits:
                known = [s.fits[downstream] for s in self.found.searches.values() if downstream in s.fits]
                if known:  # the same effects behind another path: a short way from there
                    near = max(known, key=lambda fit: fit.score)
                    search.keep(search.whole(near.plain or near.parameters))
            b = search.fit(downstream)
        return a, b

    def loses(self, names: frozenset[str], name: str) -> float:
        """By how much the log-likelihood falls without one of the effects, everything else following.

        What an effect of the last links brings may be what a film of another kind does, which a Prandtl-Ishlinskii one
        plus the effect can be fitted to almost as well: both fits may have relays. The one without it begins from the
        one with it, too, for two fits of such a film may differ by more.
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
        if names in self.found.relayed or b is None or b.parameters.has_relays:
            return
        self.found.relayed.add(names)
        if self.last(upstream).relayed(downstream).score > b.score:
            self.found.joint[names] = None

    def score(self, names: frozenset[str]) -> float:
        """Log-likelihood of both channels, up to a constant of the record."""
        a, b = self.fits(names)
        return (-a.minus_log if a is not None else 0.0) + (b.score if b is not None else 0.0)

    def apart(self) -> Chain:
        """The same, of which another search may begin: what it finds is its own."""
        first = self.first
        return replace(self, first=replace(first, fits=dict(first.fits)) if first is not None else None, found=Found())
