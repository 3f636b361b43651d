"""Starts of the base fit: the plate by its heat balance, the film by its record's own branches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import Kind
from sim.effects.effect import Effect
from sim.inference.film.preisach_density import relays_over
from sim.inference.joint.films import ENVELOPES, Curve, PIFilm, PreisachFilm, curve_over
from sim.inference.joint.likelihood import ROUNDS, SETTLED, Fit, Joint, Point, TwoChannels
from sim.inference.joint.plate_starts import rough_balances
from sim.inference.memory import begun, gaps_of, through_gaps
from sim.inference.noise import ChannelNoise, Metric, Noise, discrepancy, rough_noise
from sim.inference.nuisance import LEAST_NOISE_DEC, LEAST_NOISE_K, WORTH
from sim.model.record_own import FilmStart

SHARES: Final = (0.0, 0.5, 1.0)  # of the loop's width that the envelopes' centres are apart: the radii give the rest
STEEPER: Final = (0.7, 1.0, 1.5)  # envelopes than the branches that they make
LEVELS: Final = (0.25, 0.5, 0.75)  # of the output's range, at which branches are looked up
SLOPES: Final = (1.0, 120.0)  # of a branch, times the record's range
RELAYS: Final = 24  # thresholds of either sense of a film of another kind: 16 leave something over, 36 gain nothing
STEEPNESS: Final = 0.45  # of its relays: the smoothest that are as steep as films of grains, whose evidence is largest
WEIGHTS_DEC: Final = (0.1, 0.03, 0.01, 0.003)  # prior deviations of a relay's weight
TRIED: Final = 3  # of the starts of the film that are descended from
FIRST_STEPS: Final = 6  # of these descents
FAR_WORSE: Final = 2.0  # times the error of the best simulation


def first_metric(joint: Joint) -> Metric:
    """White noise as the readings show it from row to row."""
    at_K, at_dec = joint.readings()
    temperature = ChannelNoise(Noise(max(joint.rough_K, LEAST_NOISE_K, 0.3 * joint.record.step_K)), at_K)
    if joint.film is None:
        return Metric(temperature, None)
    return Metric(temperature, ChannelNoise(Noise(max(rough_noise(joint.output), LEAST_NOISE_DEC)), at_dec))


def plate_fit(record: TwoChannels, kinds: Sequence[Kind] = ("peltier",)) -> Fit:
    """The plate alone, of the likeliest kind and module, its numbers constant or changing with temperature."""
    modules = [(kind, slopes) for kind in kinds for slopes in ((True, False) if kind == "peltier" else (False,))]
    if record.current_A is None:
        modules = modules[:1]
    found = [module_fit(Joint(record, (), None, kind, slopes=slopes)) for kind, slopes in modules]
    # a discrepancy makes up for any plate: one that simulates far worse than another is none
    least = min(fit.most[0] for fit in found)
    found = [fit for fit in found if fit.most[0] <= FAR_WORSE * least]
    return max(found, key=lambda f: f.log_likelihood - 0.5 * f.joint.module.parameters * math.log(f.joint.rows_K.size))


def module_fit(joint: Joint, rounds: int = ROUNDS, last: float = SETTLED, start: Array | None = None) -> Fit:
    """The plate alone, of a module of one kind: first by the least error of the simulation, then with its noise, in so
    many rounds. last: log-likelihood that the last step of each descent gains; start: of what no balance tells."""
    metric = first_metric(joint)
    if not joint.driven:
        at = joint.solve(joint.start(), metric)
        path = joint.noise(at, metric).temperature
        return Fit(joint, at, Metric(path, None, simulated=False), 0.0)
    tried = []
    for par in rough_balances(joint.record, joint.kind):
        x = joint.start() if start is None else start.copy()
        for name, value in zip(("s", "r", "g", "q", "ambient_degC"), par, strict=True):
            if name in joint.place:
                x[joint.place[name]] = value
        x = np.clip(x, joint.low, joint.high)
        at = joint.solve(x, metric)
        if math.isfinite(at.cost):
            tried.append(joint.descend(at, metric, 5, 1.0))
    at = min(tried, key=lambda p: p.cost)
    return settled(joint, at.x, metric, None, rounds, last)


def settled(
    joint: Joint, x: Array, metric: Metric, own: Array | None = None, rounds: int = ROUNDS, last: float = SETTLED
) -> Fit:
    """The fit by the least error of the simulation, and with a discrepancy that is no larger than what that leaves."""
    for _ in range(2):
        at = joint.descend(joint.solve(x, metric, own), metric, 30, last)
        size = float(np.sqrt(np.mean(at.residual_K**2)))
        white = ChannelNoise(Noise(max(size, LEAST_NOISE_K)), metric.temperature.readings)
        output = metric.output
        if output is not None:
            left = float(np.sqrt(np.mean(at.residual_dec**2)))
            output = ChannelNoise(Noise(max(left, LEAST_NOISE_DEC)), output.readings)
        metric, x, own = metric.of(white, output), at.x, at.known_own
    most = size, (left if output is not None else math.inf)
    return joint.fit(x, joint.noise(at, metric, most), own, rounds, most, settled=last)


def branches(record: TwoChannels, degC: Array) -> tuple[tuple[float, float], float]:
    """(centres of the rising and of the falling branch, degC; slope of a tanh as steep as they are, 1/K), from the
    output over a smooth temperature of the rows: at each level of output the branches are the hottest of the rising and
    the coldest of the falling rows, and minor loops lie between."""
    assert record.output is not None
    used = np.flatnonzero(record.output_used)
    t, y = degC[used], record.output[used]
    low, high = np.percentile(y, [1.0, 99.0])
    share, rate = (y - low) / max(high - low, 1e-9), np.gradient(t)
    at = np.empty((2, len(LEVELS)))
    for k, (side, end) in enumerate(((1.0, 90.0), (-1.0, 10.0))):
        for j, level in enumerate(LEVELS):
            near = np.abs(share - level) < 0.5 * (LEVELS[1] - LEVELS[0])
            rows = near & (side * rate > 0.0)
            rows = rows if np.any(rows) else near
            at[k, j] = np.percentile(t[rows], end) if np.any(rows) else np.median(t)
    between = 0.5 * float(np.sum(at[:, -1] - at[:, 0]))  # of a tanh that is 2 atanh(1/2) / slope
    least, most = (slope / float(np.ptp(degC)) for slope in SLOPES)
    slope = 2.0 * math.atanh(0.5) / max(between, 1e-9)
    return (float(at[0, 1]), float(at[1, 1])), min(max(slope, least), most)


def film_starts(
    record: TwoChannels,
    degC: Array,
    curve: Curve | None = None,
    ordered: bool = False,
    start: FilmStart | None = None,
) -> list[PIFilm]:
    """PI films from which a fit is to begin. degC: a smooth temperature of the film in the rows; curve, ordered: as of
    `PIFilm`, a smooth curve where none is given; start: the memory, None where it is to be guessed."""
    centres, slope = branches(record, degC)
    middle, width = 0.5 * sum(centres), max(centres[0] - centres[1], 0.0)
    ends = float(np.min(degC)), float(np.max(degC))
    curve = curve or curve_over(*ends)
    start = start or FilmStart("cooled" if degC[0] > middle + width else "heated")
    return [
        PIFilm(curve, (middle + apart, middle - apart), slope * factor, ends, start, ordered=ordered)
        for apart in (0.5 * share * width for share in SHARES)
        for factor in STEEPER
    ]


def with_other_envelopes(fit: Fit) -> list[Fit]:
    """The fit of a PI film with envelopes of each other function, after a few steps."""
    film, values = fit.joint.film, fit.at.x[fit.joint.is_film]
    assert isinstance(film, PIFilm)
    metric = fit.metric.tight() if fit.metric.simulated else fit.metric
    fits = []
    for function in ENVELOPES:
        if function != film.function:
            x = fit.at.x.copy()
            other, x[fit.joint.is_film] = film.enveloped(function, values)
            joint = fit.joint.having(fit.effects, other)
            at = joint.descend(joint.solve(x, metric, fit.at.known_own), metric, FIRST_STEPS, 1.0)
            fits.append(Fit(joint, at, metric, joint.log_likelihood(at, metric), fit.most))
    return fits


def with_preisach_film(fit: Fit, effects: Sequence[Effect]) -> Fit:
    """The fit with a Preisach film in place of its own, and some of its effects; the prior of the weights is the one of
    the largest evidence."""
    old = fit.joint.film
    assert isinstance(old, PIFilm)
    assert fit.metric.output is not None
    rows = fit.joint.rows_dec
    film = PreisachFilm(old.curve, relays_over(_smooth_path(fit)[rows], fit.joint.output, RELAYS, STEEPNESS), old.start)
    joint = fit.joint.having(effects, film)
    metric = replace(fit.metric, output=fit.metric.output.without_slow())
    first = joint.fit(joint.from_other(fit.joint, fit.at.x), metric, fit.at.own, rounds=1, most=fit.most, steps=0)
    tried = []
    for weight_dec in WEIGHTS_DEC:
        other = joint.having(effects, replace(film, weight_dec=weight_dec))
        at = other.solve(first.at.x, first.metric, first.at.own)
        tried.append(Fit(other, at, first.metric, other.log_likelihood(at, first.metric), fit.most))
    return thinned(max(tried, key=evidence_of_film))


def evidence_of_film(fit: Fit) -> float:
    """Log-likelihood less what the film's coefficients and unknowns cost: the marginal likelihood over the coefficients
    that carry the film (D. MacKay, Neural Computation 4 (1992) 415), and half a ln(rows) for each unknown."""
    film, at = fit.joint.film, fit.at
    if film is None:
        return fit.log_likelihood
    active = at.design[:, at.active] / np.sqrt(film.precision[at.active])
    _, volume = np.linalg.slogdet(np.eye(active.shape[1]) + active.T @ active)
    return float(fit.log_likelihood - 0.5 * volume - 0.5 * len(film.unknowns) * math.log(fit.joint.rows_dec.size))


def in_domains(fit: Fit, parts: tuple[int, int]) -> Fit:
    """The fit with its Preisach film in domains: a discrepancy over its memory. parts: as in `domain_columns`."""
    output, film = fit.metric.output, fit.joint.film
    assert output is not None
    assert isinstance(film, PreisachFilm)
    relays = film.relays(fit.at.coefficients)
    metric = replace(fit.metric, output=fit.joint.in_domains(fit.at, output.without_slow(), relays, parts))
    return fit.joint.fit(fit.at.x, fit.joint.noise(fit.at, metric, fit.most), fit.at.own, most=fit.most)


def thinned(fit: Fit) -> Fit:
    """The fit of a Preisach film with those of all of its steps that carry it."""
    film = fit.joint.film
    assert isinstance(film, PreisachFilm)
    every = fit.joint.having(fit.effects, film.of_all or film)
    at = every.solve(fit.at.x, fit.metric, fit.at.own)
    of_all = every.film
    assert isinstance(of_all, PreisachFilm)
    joint = fit.joint.having(fit.effects, of_all.only(at.active))
    return joint.fit(at.x, fit.metric, at.own, most=fit.most)


def base_fit(record: TwoChannels, kinds: Sequence[Kind] = ("peltier",)) -> Fit:
    """The fit without any effect, of whatever channels the record has, and of the likelier kind of plate."""
    return with_first_film(plate_fit(record, kinds))


def with_first_film(plate: Fit) -> Fit:
    """The fit of a plate with a film beside it, where the record has one."""
    if plate.joint.record.output is None:
        return plate
    best = _with_film(plate)
    metric = best.metric.without_slow()
    joint, at = remembering(best.joint, best.at, metric)
    return remembered(settled(joint, at.x, metric, at.own))


def remembering(
    joint: Joint, at: Point, metric: Metric, worth: float = WORTH, known: bool = False
) -> tuple[Joint, Point]:
    """The likelihood and point with the film's memory at the first row and through gaps that suits best, the same if
    none is clearly better. worth: as of `begun`; known: whether the memory at the first row is."""
    film, record = joint.film, joint.record
    assert film is not None

    def begun_with(start: FilmStart) -> tuple[Joint, Point]:
        other = joint.having(joint.effects, film.starting_with(start))
        return other, other.solve(at.x, metric, at.own, at.run)

    def cost(start: FilmStart) -> float:
        return begun_with(start)[1].cost

    seen_degC = at.run.path.plate_degC
    start, first_degC = film.start, float(at.run.path.at(np.zeros(1))[0])
    if not known:
        start = begun(start, first_degC, seen_degC, cost, worth)
    start = through_gaps(start, gaps_of(record, at.run.path), seen_degC, cost, worth)
    return (joint, at) if start == film.start else begun_with(start)


def remembered(fit: Fit) -> Fit:
    """The fit with the memory of its film chosen anew."""
    if isinstance(fit.joint.film, PreisachFilm):
        return thinned(fit)
    if fit.joint.film is None:
        return fit
    joint, at = remembering(fit.joint, fit.at, fit.metric)
    return fit if joint is fit.joint else joint.fit(at.x, fit.metric, at.own, most=fit.most)


def with_pi_film(fit: Fit) -> Fit:
    """The fit with a PI film begun anew from all starts."""
    found = _with_film(fit)
    metric = replace(fit.metric, output=found.metric.output)
    joint, at = remembering(found.joint, found.at, metric)
    return remembered(joint.fit(at.x, metric, at.own, most=fit.most))


def restarted(fit: Fit) -> Fit:
    """The fit with its film begun anew, where that is likelier: local minima look like effects."""
    return max(fit, with_pi_film(fit), key=lambda f: f.log_likelihood)


def with_plate_anew(fit: Fit) -> Fit:
    """The fit with its plate begun anew from all starts, where that is likelier: a large discrepancy stands in for
    parameters that are off, and keeps them there."""
    joint, metric = fit.joint, fit.metric
    thermal = joint.thermometer_alone()
    plate = module_fit(thermal, start=thermal.from_other(joint, fit.at.x))
    x = joint.with_thermal(fit.at.x, thermal, plate.at.x)
    most = min(fit.most[0], plate.most[0]), fit.most[1]
    again = joint.fit(x, metric.of(plate.metric.temperature, metric.output), fit.at.known_own, most=most)
    return max(fit, again, key=lambda f: f.log_likelihood)


def _with_film(fit: Fit) -> Fit:
    return with_film_of(fit, film_starts(fit.joint.record, _smooth_path(fit)))


def with_film_of(fit: Fit, starts: Sequence[PIFilm]) -> Fit:
    """The best of a film's starts after a few steps, the noise of the output white; all else as in a fit."""
    tried: list[tuple[float, Joint, Array, Metric]] = []
    for film in starts:
        joint = fit.joint.having(fit.effects, film)
        output = fit.metric.output.without_slow() if fit.metric.output else first_metric(joint).output
        metric = replace(fit.metric, output=output)
        x = np.where(joint.is_film, joint.start(), joint.from_other(fit.joint, fit.at.x))
        own = fit.at.known_own
        at = joint.solve(x, metric, own)
        tried.append((at.cost, joint, x, metric))
    fits: list[Fit] = []
    for _, joint, x, metric in sorted(tried, key=lambda entry: entry[0])[:TRIED]:
        own = fit.at.known_own
        at = joint.descend(joint.solve(x, metric, own), metric, FIRST_STEPS, 1.0)
        fits.append(Fit(joint, at, metric, -at.cost))
    return max(fits, key=lambda f: f.log_likelihood)


def _smooth_path(plate: Fit) -> Array:
    """The temperature in the rows: simulated, with the smoothed discrepancy."""
    channel = plate.metric.temperature
    shown = plate.at.run.shown_degC
    if not plate.joint.driven:
        return plate.at.run.path.at(plate.joint.record.time_s)
    if channel.noise.slow == 0.0:
        return shown
    mean, _ = discrepancy(plate.at.residual_K, channel.noise, channel.readings)
    return np.asarray(shown + np.interp(plate.joint.record.time_s, channel.readings.time_s, mean))
