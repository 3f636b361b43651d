"""One likelihood of a record: thermometer and ohmmeter together, for any set of effects and any form of film.

    T_k = shown(theta)_k + d_k + noise,                  d: what the plate's model lacks (`sim.inference.noise`)
    y_k = sum_j c_j A_kj(theta, path) + e_k + noise      A: the film's columns through the ohmmeter

theta: plate, first temperatures, film envelopes and effects. The coefficients c (operator weights >= 0, D(T), offset)
enter linearly and are projected out (G. Golub, V. Pereyra, Inverse Problems 19 (2003) R1). The path that drives the
film is the simulated plate plus the smoothed d: where the plate's model is right this is the simulation. Without a
current it is the path behind the thermometer's readings. Its remaining error counts as variance of y.

Both channels are whitened with their noise, so that evidence is discounted wherever a model is wrong. Derivatives are
secants, one simulation each.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import (
    AMBIENT,
    LARGEST_SLOPE_PER_K,
    RESISTANCE_SLOPE_PRIOR_PER_K,
    SEEBECK_SLOPE_PRIOR_PER_K,
    Kind,
)
from sim.effects.effect import Effect, Filter, HeatFlow, Switched, jumps, switched, with_pinned
from sim.inference.covariance import Covariance, block_sandwich
from sim.inference.joint.domains import Domains, Relays, domain_columns
from sim.inference.levenberg_marquardt import Damping, Linearized, descend, held_at_bounds
from sim.inference.nnls import reduced, solve_triangle
from sim.inference.noise import (
    ChannelNoise,
    Metric,
    Noise,
    Readings,
    discrepancy,
    estimated_noise,
    likelier_of_rounded,
    noise_of_instrument,
    of_rounded,
    rough_noise,
)
from sim.inference.nuisance import (
    LATE_SPREAD,
    LEAST_NOISE_DEC,
    LEAST_NOISE_K,
    ROOM_SPREAD_K,
    STEP_LATE,
    first_readings,
    resting_K,
)
from sim.inference.readings.temperature_path import temperature_path
from sim.model.film_nodes import FilmNodes, film_nodes
from sim.model.inputs import Inputs
from sim.model.links import Links, behind, columns_followed, links_of
from sim.model.meter_power import MeterCurrent, MeterPower
from sim.model.ohmmeter import Ohmmeter, before_ranges, shown_in_rows
from sim.model.plate_path import Nodes, PlatePath, plate_nodes, simulate_plate
from sim.model.record_own import FilmStart, anew_rows
from sim.model.record_run import straight_path
from sim.model.recorded import Recorded, Rows, driven_rows

Mask = NDArray[np.bool_]
OWN: Final = ("ambient_degC", "room_K.", "first_degC.")  # what belongs to a record, and bodies' first temperatures
AMBIENT_DEGC: Final = (25.0, 15.0)  # mean and deviation: a room, a cold room, an oven's surroundings
SHARE: Final = (0.4, 0.3)  # of the largest current in that of largest cooling, s (T + 273.15) / r, at 300 K
PLATE_NAMES: Final = {  # of the plate's unknowns, as a model file has them
    "s": "seebeck_over_capacity_per_A_s",
    "r": "resistance_over_capacity_K_per_A2_s",
    "q": "drive_over_capacity_K_per_s",
    "g": "conductance_over_capacity_per_s",
    "ambient_degC": "ambient_degC",
    "s_slope": "seebeck_slope_per_K",
    "r_slope": "resistance_slope_per_K",
}
LATE: Final = ".late"  # of a filter behind the plate: how far it is behind at the first row, K or decades
RELATIVE_STEP: Final = 1e-3  # of a secant of a positive parameter: rounding is 1e-10, curvature 1e-3
STEP_K: Final = 0.01  # of a secant of a temperature
SETTLED: Final = 0.05  # log-likelihood that a last step gains: values are then within a third of their deviations
STEPS: Final = 12  # of a descent: from a near start 4 to 6 are taken
SIMULATION_STEPS: Final = 30  # of a descent to the simulation's least error, from a point that may be far
ROUNDS: Final = 3  # of fit and noise in turn
BESIDE: Final = 10.0  # how far beyond its typical range an effect's size may go in a fit, as a factor
# a module's numbers are told apart by a thousandth of what each does: more damping creeps along that valley
DAMPING: Final = Damping(1e-6, 0.2, 8.0, 1e-9, 1e-6, 8)
ROUNDED: Final = 0.5  # of a noise: a step of readings that is larger is seen in their likelihood
NEAR: Final = 1.0  # squared deviations from where derivatives were taken: residuals tell no difference within them
RANGES: Final = 3.0  # deviations of a reading from a threshold within which either range may have been on


class TwoChannels(Recorded, Protocol):
    """What the likelihood asks of a record: times and commands (`Recorded`), and what was read, nan where nothing."""

    @property
    def temperature_degC(self) -> Array: ...

    @property
    def temperature_used(self) -> Mask: ...

    @property
    def step_K(self) -> float: ...

    @property
    def current_A(self) -> Array | None: ...

    @property
    def course_degC(self) -> Array | None: ...

    @property
    def output(self) -> Array | None: ...

    @property
    def output_used(self) -> Mask: ...

    @property
    def joined(self) -> Rows: ...


@dataclass(frozen=True)
class Unknown:
    """One nonlinear parameter. step: of its secant; prior: mean and deviation; thermal: it moves the plate."""

    name: str
    start: float
    step: float
    low: float = -math.inf
    high: float = math.inf
    prior: tuple[float, float] | None = None
    thermal: bool = True


class FilmForm(Protocol):
    """A form of film: nonlinear unknowns, and columns for given values of them."""

    @property
    def start(self) -> FilmStart: ...

    @property
    def unknowns(self) -> tuple[Unknown, ...]: ...

    @property
    def precision(self) -> Array:
        """Of the normal priors of the coefficients, free ones first, (columns,), 1/decades^2."""
        ...

    @property
    def free(self) -> int:
        """How many coefficients, the first ones, may have either sign."""
        ...

    def starting_with(self, start: FilmStart) -> FilmForm:
        """The same with another memory at the first row and through gaps."""
        ...

    def columns(self, values: Array, nodes: FilmNodes) -> Array:
        """Of the film's own output at the points, (points, columns); those beyond `free` are its hysteretic part."""
        ...


class Module(NamedTuple):
    """What moves a plate: a Peltier module or a heater; slopes: its Seebeck coefficient and resistance change with
    temperature."""

    kind: Kind
    slopes: bool = False

    @property
    def parameters(self) -> int:
        """How many numbers its drive has: s, r and their slopes, or q."""
        return 1 if self.kind == "heater" else 4 if self.slopes else 2


@dataclass(frozen=True, eq=False)
class Simulated:
    """One simulation. shown_degC: (rows,); path: of the film; nodes and links of the film's side; columns: of its own
    output at the points, (points, columns), None without a film; late_dec: how far each of the ohmmeter's filters is
    behind at the first node; owed_dec: what filters of the film's output are still behind since then, at the points."""

    shown_degC: Array
    path: PlatePath
    links: Links
    nodes: FilmNodes | None = None
    columns: Array | None = None
    late_dec: tuple[float, ...] = ()
    owed_dec: Array | None = None


@dataclass(frozen=True, eq=False)
class Point:
    """A place in parameter space with its best coefficients. residual_K, residual_dec: of the used readings; own: the
    film's own output in the rows; shown_dec: as the ohmmeter shows it, in the rows; design: the film's columns in the
    used readings; active: the columns that carry the fit; cost: minus the log-likelihood without `log_scale`; known_K:
    the share of its information that a thermometer's reading still has after it was rounded; tangent: x of a place
    nearby, and the derivatives of both channels' readings there."""

    x: Array
    run: Simulated
    residual_K: Array
    cost: float
    white_K: Array
    known_K: Array
    coefficients: Array = field(default_factory=lambda: np.empty(0))
    active: Mask = field(default_factory=lambda: np.empty(0, dtype=np.bool_))
    design: Array = field(default_factory=lambda: np.empty((0, 0)))
    residual_dec: Array = field(default_factory=lambda: np.empty(0))
    white_dec: Array = field(default_factory=lambda: np.empty(0))
    own: Array = field(default_factory=lambda: np.empty(0))
    range_of: Array = field(default_factory=lambda: np.empty(0))
    shown_dec: Array = field(default_factory=lambda: np.empty(0))
    tangent: tuple[Array, Array] | None = None

    @property
    def known_own(self) -> Array | None:
        """The film's own output in the rows, None without a film."""
        return self.own if self.own.size else None


@dataclass(frozen=True, eq=False)
class Fit:
    """A set of effects fitted: the point, its noise and log-likelihood (priors of the parameters
    included). most: how large the discrepancies could be at most."""

    joint: Joint
    at: Point
    metric: Metric
    log_likelihood: float
    most: tuple[float, float] = (math.inf, math.inf)

    @property
    def effects(self) -> tuple[Effect, ...]:
        return self.joint.effects

    def values(self) -> dict[str, dict[str, float]]:
        """Each effect's parameters."""
        return {e.name: e.values() for e in self.joint.switched(self.at.x)}

    def covariance(self, without: Sequence[str] = ()) -> Covariance:
        """Of all nonlinear parameters, the film's weights projected off. without: parameters whose priors are left out,
        so that only the record tells of them. The plate's discrepancy is that of the restricted likelihood. Whitened
        residuals of a right model are white; where they are not quite, the sandwich over blocks of rows widens it."""
        joint, at, channel = self.joint, self.at, self.metric.temperature
        known = np.isfinite(joint.prior_deviation) & ~np.isin(joint.names, without)
        precision = np.diag(np.where(known, joint.prior_deviation, np.inf) ** -2.0)
        derivatives, split = joint.derivatives(at, self.metric), joint.rows_K.size
        if joint.driven and channel.noise.slow > 0.0:
            more = joint.whitened(at, self.metric, derivatives)[split:]
            channel = channel.restricted(at.residual_K, derivatives[:split], precision + more.T @ more)
            at = replace(at, white_K=channel.whitening.of(at.residual_K))
        jacobian, residual = joint.whitened(at, Metric(channel, self.metric.output), derivatives), joint.residual(at)
        if joint.film is not None:
            active = at.design[:, at.active]
            normal = active.T @ active + np.diag(joint.film.precision[at.active])
            scale = 1.0 / np.sqrt(np.diag(normal))
            normal = normal * np.outer(scale, scale) + 1e-9 * np.eye(scale.size)
            film = jacobian[split:]
            film = film - (active * scale) @ cho_solve(cho_factor(normal), (active * scale).T @ film)
            jacobian = np.vstack((jacobian[:split], film))
        return block_sandwich(jacobian, residual, precision=precision)

    @cached_property
    def by_thermometer(self) -> Fit:
        """The fit of the thermometer alone, from here on: what it shows of plate and effects by itself.

        A film is a far better thermometer, and its model is right to about its noise only: it pulls the plate's numbers
        aside by many of the errors that it leaves them. So it has no say in what is known without it (modularization:
        F. Liu, M. Bayarri, J. Berger, Bayesian Anal. 4 (2009) 119)."""
        if self.joint.film is None or not self.joint.driven:
            return self
        thermal = self.joint.thermometer_alone()
        metric = Metric(self.metric.temperature, None)
        return thermal.fit(thermal.from_other(self.joint, self.at.x), metric, most=(self.most[0], math.inf))

    @cached_property
    def for_simulation(self) -> Fit:
        """The fit with its thermal side where the simulation's error is least, if that lacks more than the noise.

        A model that lacks something has two best sets of numbers. Those of the largest likelihood leave to the
        discrepancy all that is slow, and say what the rest of the record shows of each effect. Those of the least error
        are the ones to predict with (R. Tuo, C. F. J. Wu, Ann. Statist. 43 (2015) 2331). Each reading then counts as
        one with white noise of the discrepancy's density at low frequencies, so that priors keep their weight; until a
        current first drove the plate nothing is amiss, and it counts fully."""
        joint, channel = self.joint, self.metric.temperature
        noise = channel.noise
        if not joint.driven or channel.of_instrument or noise.slow <= noise.white:
            return self
        thermal = joint.thermometer_alone()
        lasts = 1.0 + noise.tau_s / channel.readings.step_s()
        driven = driven_rows(joint.record, joint.record.joined)[joint.rows_K]
        variance = np.where(driven, 1.0 + noise.ratio * lasts, 1.0)
        white = ChannelNoise(Noise(noise.white), replace(channel.readings, variance=variance))
        metric = Metric(white, None)
        at = thermal.descend(thermal.solve(thermal.from_other(joint, self.at.x), metric), metric, SIMULATION_STEPS)
        x = joint.with_thermal(self.at.x, thermal, at.x)
        metric = joint.noise(joint.solve(x, self.metric, self.at.known_own), self.metric)
        again = joint.solve(x, metric, self.at.known_own)
        return Fit(joint, again, metric, joint.log_likelihood(again, metric), self.most)


def coordinate(value: float, signed: bool) -> float:
    """The fit's coordinate of an effect's parameter: a logarithm, unless it can have either sign."""
    return value if signed else math.log(value)


class Joint:
    """The likelihood of one record (or several, joined) for one set of effects and one form of film."""

    def __init__(
        self,
        record: TwoChannels,
        effects: Sequence[Effect],
        film: FilmForm | None,
        kind: Kind = "peltier",
        coefficients: Array | None = None,
        slopes: bool = True,
    ) -> None:
        """coefficients: the film's, where they are known: then only what belongs to the record is fitted. slopes:
        whether a module's Seebeck coefficient and resistance change with temperature. Raises ValueError for effects
        that clash."""
        self.record, self.effects, self.film, self.kind = record, tuple(effects), film, kind
        self.slopes = slopes and kind == "peltier"
        self.coefficients = coefficients
        self.rows_K = np.flatnonzero(record.temperature_used)
        self.degC = record.temperature_degC[self.rows_K]
        self.rows_dec = np.flatnonzero(record.output_used) if film is not None else np.empty(0, dtype=np.int64)
        self.output = record.output[self.rows_dec] if film is not None and record.output is not None else np.empty(0)
        self.driven = record.current_A is not None
        self.anew = anew_rows(record)
        temperature = np.where(record.temperature_used, record.temperature_degC, np.nan)
        self.first_degC = first_readings(record, temperature) if self.driven else np.empty(0)
        self.rough_K = rough_noise(self.degC)
        self.rounded = self.driven and record.step_K > ROUNDED * self.rough_K
        self.unknowns = self._layout()
        self.names = [unknown.name for unknown in self.unknowns]
        self.place = {name: k for k, name in enumerate(self.names)}
        self.low = np.array([unknown.low for unknown in self.unknowns])
        self.high = np.array([unknown.high for unknown in self.unknowns])
        priors = [unknown.prior or (0.0, math.inf) for unknown in self.unknowns]
        self.prior_mean, self.prior_deviation = (np.array(column) for column in np.reshape(priors, (-1, 2)).T)
        own = [name.startswith(OWN) or ".first_K." in name or name.endswith(LATE) for name in self.names]
        jumping = {f"{e.name}.{p.name}" for e in self.effects if jumps(e) for p in e.parameters}
        descends = np.array([name not in jumping for name in self.names], dtype=np.bool_)
        self.moves = np.array(own) if coefficients is not None else descends
        self._nodes: tuple[tuple[float, ...], Nodes] | None = None
        first = self.place[film.unknowns[0].name] if film and film.unknowns else len(self.unknowns)
        self._first_of_film = first

    def on(self, record: TwoChannels, coefficients: Array | None = None) -> Joint:
        """The likelihood of another record, or of other readings."""
        return Joint(record, self.effects, self.film, self.kind, coefficients, self.slopes)

    def having(self, effects: Sequence[Effect], film: FilmForm | None = None, module: Module | None = None) -> Joint:
        """The likelihood of the same record with other effects, and maybe another form of film, or another module."""
        module = module or self.module
        other = Joint(self.record, effects, film or self.film, module.kind, self.coefficients, module.slopes)
        for name in ("_measured_path", "measured"):
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other

    def thermometer_alone(self) -> Joint:
        """The likelihood of the thermometer's readings alone, with the effects that they tell of."""
        effects = [e for e in self.effects if e.before_film]
        return Joint(self.record, effects, None, self.kind, slopes=self.slopes)

    def with_thermal(self, x: Array, thermal: Joint, found: Array) -> Array:
        """The parameters with those that were found from the thermometer alone."""
        x = x.copy()
        x[[self.place[name] for name in thermal.names]] = found
        return x

    @property
    def module(self) -> Module:
        """What moves the plate."""
        return Module(self.kind, self.slopes)

    # ---- parameters ---------------------------------------------------------------------------------------------

    def _layout(self) -> list[Unknown]:
        out: list[Unknown] = []
        if self.driven:
            if self.kind == "peltier":
                out.append(Unknown("s", 1.6e-3, 1e-3 * RELATIVE_STEP, 1e-7, 1.0))
                out.append(Unknown("r", 0.06, 0.05 * RELATIVE_STEP, 0.0, 10.0))
            else:
                out.append(Unknown("q", 0.6, RELATIVE_STEP, 1e-7, 100.0))
            if self.slopes:
                for name, step, prior in (
                    ("s_slope", 1e-5, SEEBECK_SLOPE_PRIOR_PER_K),
                    ("r_slope", 1e-4, RESISTANCE_SLOPE_PRIOR_PER_K),
                ):
                    out.append(Unknown(name, prior[0], step, -LARGEST_SLOPE_PER_K, LARGEST_SLOPE_PER_K, prior))
            out.append(Unknown("g", 0.02, 0.02 * RELATIVE_STEP, 1e-7, 100.0))
            out.append(Unknown("ambient_degC", AMBIENT_DEGC[0], STEP_K, prior=AMBIENT_DEGC))
            out += [Unknown(f"input.{name}", 0.0, 1e-4) for name in self.record.inputs.names]
            out += [
                Unknown(f"room_K.{k}", 0.0, STEP_K, prior=(0.0, ROOM_SPREAD_K)) for k in range(1, len(self.joined_anew))
            ]
            out += [Unknown(f"first_degC.{k}", float(degC), STEP_K) for k, degC in enumerate(self.first_degC)]
        for effect in self.effects:
            thermal = effect.before_film
            if not self.driven and effect.link in ("driver", "plate"):
                raise ValueError(f"{effect.name}: the record has no current")
            for p in effect.parameters:
                if len(p.choices) == 1:
                    continue
                name, most = f"{effect.name}.{p.name}", BESIDE * p.largest
                if p.signed:
                    out.append(Unknown(name, 0.0, 0.01 * math.sqrt(p.smallest * p.largest), -most, most, None, thermal))
                else:
                    least = math.log(p.smallest / BESIDE)
                    out.append(Unknown(name, 0.0, 0.02, least, math.log(most), None, thermal))
            if _begins_late(effect):
                out.append(Unknown(f"{effect.name}{LATE}", 0.0, STEP_LATE, prior=(0.0, LATE_SPREAD), thermal=False))
            if _begins_anew(effect):
                out += [
                    Unknown(f"{effect.name}.first_K.{k}", 0.0, STEP_K, prior=(0.0, resting_K(first)))
                    for k, first in enumerate(self._first_K)
                ]
        return out + list(self.film.unknowns if self.film else ())

    @cached_property
    def _first_K(self) -> Array:
        """The first readings above a usual room, at the beginnings, (beginnings,)."""
        return self.first_degC[np.searchsorted(self.record.first_rows, self.anew)] - AMBIENT_DEGC[0]

    @cached_property
    def joined_anew(self) -> list[int]:
        """Which of the beginnings begin a further record, the first one included."""
        return [0, *(int(k) for k in np.flatnonzero(np.isin(self.anew, self.record.joined)))]

    @cached_property
    def is_film(self) -> Mask:
        """Which of the parameters are the film's."""
        return np.arange(len(self.unknowns)) >= self._first_of_film

    def start(self) -> Array:
        """The parameters' own starts."""
        return np.array([unknown.start for unknown in self.unknowns])

    def from_other(self, other: Joint, x: Array) -> Array:
        """Parameters of another set where this one has the same; else their starts. A heater heats as much by a unit of
        drive as a Peltier module does at 300 K."""
        known = {name: float(x[k]) for name, k in other.place.items()}
        if "s" in known:
            known["q"] = 300.0 * known["s"]
        elif "q" in known:
            known |= {"s": known["q"] / 300.0, "r": SHARE[0] * known["q"] / self._largest_A}
        return np.array([known.get(u.name, u.start) for u in self.unknowns])

    def with_effect(self, x: Array, effect: Effect, values: Sequence[float]) -> Array:
        """The parameters with an effect's values."""
        x = x.copy()
        for p, value in zip(effect.parameters, values, strict=True):
            if (name := f"{effect.name}.{p.name}") in self.place:
                x[self.place[name]] = coordinate(value, p.signed)
        return x

    def switched(self, x: Array) -> list[Switched]:
        """The effects with their values."""
        found = []
        for effect in self.effects:
            values = []
            for p in effect.parameters:
                at = self.place.get(f"{effect.name}.{p.name}")
                values.append(0.0 if at is None else float(x[at]) if p.signed else math.exp(x[at]))
            found.append(switched(effect, with_pinned(effect, values)))
        return found

    def plate_numbers(self, x: Array) -> Array:
        """(s, r, g, q, T_a, slopes of s and r)."""
        names = ("s", "r", "g", "q", "ambient_degC", "s_slope", "r_slope")
        return np.array([x[self.place[name]] if name in self.place else 0.0 for name in names])

    # ---- simulation ---------------------------------------------------------------------------------------------

    def _plate(self, x: Array, links: Links) -> tuple[Array, PlatePath]:
        """What the thermometer shows in the rows, and the plate's path."""
        record = self.record
        if not self.driven:
            return np.full(record.time_s.size, float(np.mean(self.degC))), self._measured_path
        key = tuple(float(v) for e in links.commands for v in e.par)
        if self._nodes is None or self._nodes[0] != key:
            self._nodes = key, plate_nodes(record, links)
        numbers = self.plate_numbers(x)
        first = x[self.place["first_degC.0"] :][: record.first_rows.size]
        count = self.anew.size
        rooms = np.zeros(count)
        for k, at in enumerate(self.joined_anew[1:], 1):
            rooms[at:] = x[self.place[f"room_K.{k}"]]
        bodies = np.full((count, len(links.plate)), np.nan)
        bodies[0] = numbers[AMBIENT]
        for j, e in enumerate(links.plate):
            if (first_K := self.place.get(f"{e.name}.first_K.0")) is not None:
                bodies[:, j] = numbers[AMBIENT] + rooms + x[first_K : first_K + count]
        late = np.zeros((count, len(links.thermometer)))
        for j, e in enumerate(links.thermometer):
            if (first_K := self.place.get(f"{e.name}.first_K.0")) is not None:
                late[:, j] = x[first_K : first_K + count]
        inputs: Inputs = record.inputs
        heats = np.array([x[self.place[f"input.{name}"]] for name in inputs.names])
        run = simulate_plate(
            record, self._nodes[1], numbers, links, first, self.anew, bodies, late, rooms_K=rooms, inputs_K_per_s=heats
        )
        return run.shown_degC, run.path

    @cached_property
    def _measured_path(self) -> PlatePath:
        """The path behind the thermometer's readings, of a record without a current."""
        record = self.record
        if record.course_degC is not None:
            return straight_path(record.time_s, record.course_degC)
        readings = np.where(record.temperature_used, record.temperature_degC, np.nan)
        edges = [0, *record.joined.tolist(), readings.size]
        parts = [slice(first, last) for first, last in itertools.pairwise(edges)]
        found = [temperature_path(record.time_s[part], readings[part]).temperature_degC for part in parts]
        return straight_path(record.time_s, np.concatenate(found))

    def simulate(self, x: Array, metric: Metric, own: Array | None = None, held: Simulated | None = None) -> Simulated:
        """The chain at x. own: the film's own output in the rows, as far as it is known: an ohmmeter heats by it.
        held: a simulation with the same plate and thermometer."""
        links = links_of(self.switched(x))
        if held is None:
            shown, plate = self._plate(x, links)
            path = self._driving(plate, shown, metric)
        else:
            shown, path = held.shown_degC, held.path
        if self.film is None or not np.all(np.isfinite(path.plate_degC)):
            return Simulated(shown, path, links)
        power = None
        if links.heated and self.record.test_current_A is not None:
            meter = MeterCurrent(self.record.time_s, self.record.test_current_A, self.record.test_on_s)
            output = own if own is not None else self.measured
            taken_s = links.taken(self.record.taken_s)  # the current heats at the rows, whenever they were read
            order = np.argsort(taken_s, kind="stable")
            power = MeterPower(meter, np.interp(self.record.time_s, taken_s[order], output[order]))
        late_K, late_dec = (self._late(x, filters) for filters in (links.film_lags, links.meter_lags))
        nodes = film_nodes(self.record, path, links, late_K, power, self.film.start)
        columns = self.film.columns(x[self._first_of_film :], nodes)
        free = self.film.free
        owed_dec = np.zeros(nodes.points_s.size)
        for e in links.hysteretic_part:
            columns[:, free:] = columns_followed(e, nodes.points_s, columns[:, free:])
            owed_dec += self._late(x, [e])[0] * behind(e, nodes.points_s)[:, 0]
        return Simulated(shown, path, links, nodes, columns, late_dec, owed_dec if links.hysteretic_part else None)

    def _late(self, x: Array, filters: Sequence[Switched]) -> tuple[float, ...]:
        """How far each of some filters is behind at the first row."""
        return tuple(float(x[self.place[f"{e.name}{LATE}"]]) for e in filters)

    @cached_property
    def measured(self) -> Array:
        """The measured output in all rows, straight between used readings."""
        return np.interp(np.arange(self.record.time_s.size), self.rows_dec, self.output)

    def _driving(self, plate: PlatePath, shown: Array, metric: Metric) -> PlatePath:
        """The plate's path with the smoothed discrepancy of the thermometer."""
        channel = metric.temperature
        if channel.noise.slow == 0.0 or channel.of_instrument or self.film is None or not self.driven:
            return plate
        residual = self.degC - shown[self.rows_K]
        if not np.all(np.isfinite(residual)):
            return plate
        mean, _ = discrepancy(residual, channel.noise, channel.readings)
        return plate.raised(self.record.time_s[self.rows_K], mean)

    def _shown(self, run: Simulated, signal: Array, range_of: Array | None) -> Array:
        """What the ohmmeter shows in the rows for the film's own output at the points."""
        assert run.nodes is not None
        signal = signal if run.owed_dec is None else signal + run.owed_dec
        return shown_in_rows(run.links, run.nodes, signal, range_of, run.late_dec)

    def solve(self, x: Array, metric: Metric, own: Array | None = None, held: Simulated | None = None) -> Point:
        """The point at x. own: the film's own output in the rows at a point near it; held: as in `simulate`."""
        run = self.simulate(x, metric, own, held)
        residual = self.degC - run.shown_degC[self.rows_K]
        if not np.all(np.isfinite(residual)) or np.max(np.abs(residual)) > 1e5:
            return Point(x, run, residual, math.inf, residual, np.ones(residual.size))
        away = (x - self.prior_mean) / self.prior_deviation
        cost = 0.5 * float(away @ away) + self._share_cost(x)
        if metric.temperature.step > 0.0:
            logs, white, known = of_rounded(residual, metric.temperature.step, metric.temperature.noise.white)
            cost += metric.temperature.log_scale - float(np.sum(logs))
            point = Point(x, run, residual, cost, white, known)
        else:
            white = metric.temperature.whitening.of(residual)
            cost += 0.5 * float(white @ white)
            point = Point(x, run, residual, cost, white, np.ones(white.size))
        if run.columns is None:
            return point if self.film is None else replace(point, cost=math.inf)
        point = self._solve_film(point, metric, self.measured if own is None else own)
        if run.links.bends or run.links.heated:  # about the film's own output of this very point
            if run.links.heated:
                point = replace(point, run=self.simulate(x, metric, point.own, run))
            point = self._solve_film(replace(point, cost=cost), metric, point.own)
        return point

    def _solve_film(self, point: Point, metric: Metric, own: Array) -> Point:
        run, film, output = point.run, self.film, metric.output
        assert film is not None
        assert output is not None
        assert run.nodes is not None
        assert run.columns is not None
        signal = run.nodes.at_points(own)
        range_of = before_ranges(run.links, run.nodes, signal) if run.links.readings else None
        meter = Ohmmeter(run.links, run.nodes, signal)
        design = meter.plain(run.columns)[self.rows_dec]
        target = self.output
        if not run.links.linear or any(run.late_dec) or run.owed_dec is not None:
            known = self._shown(run, signal, range_of) - meter.plain(signal[:, None])[:, 0]
            target = target - known[self.rows_dec]
        white = output.whitening.of(np.column_stack((design, target)))
        normal = white.T @ white
        normal[np.diag_indices(film.precision.size)] += film.precision
        if self.coefficients is None:
            coefficients, _ = solve_triangle(reduced(normal), film.free)
        else:
            coefficients = self.coefficients
        white_dec = white[:, -1] - white[:, :-1] @ coefficients
        active = coefficients != 0.0
        active[: film.free] = True
        cost = 0.5 * float(white_dec @ white_dec + film.precision @ coefficients**2)
        at_points = run.columns @ coefficients
        return replace(
            point,
            cost=point.cost + cost,
            coefficients=coefficients,
            active=active,
            design=white[:, :-1],
            residual_dec=target - design @ coefficients,
            white_dec=white_dec,
            own=run.nodes.of_rows(at_points),
            range_of=np.empty(0) if range_of is None else range_of,
            shown_dec=self._shown(run, at_points, range_of),
        )

    def change(self, at: Point, metric: Metric, x: Array, thermal: bool, joint: Joint | None = None) -> Array:
        """Change of both channels' used readings from a point to other parameters, coefficients held, (readings of
        both,). joint: of another set of effects, whose parameters x are."""
        joint = joint or self
        run = joint.simulate(x, metric, at.known_own, None if thermal else at.run)
        change = (run.shown_degC - at.run.shown_degC)[self.rows_K]
        if self.film is None:
            return change
        if run.columns is None or not np.all(np.isfinite(change)):
            return np.full(change.size + self.rows_dec.size, np.nan)
        signal = run.columns @ at.coefficients
        range_of = at.range_of if at.range_of.size else self.measured if run.links.readings else None
        shown = joint._shown(run, signal, range_of)
        return np.append(change, (shown - at.shown_dec)[self.rows_dec])

    def whitened(self, at: Point, metric: Metric, changes: Array) -> Array:
        """Changes of both channels' used readings in units of their noise, (readings of both, changes)."""
        split = self.rows_K.size
        white = metric.temperature.whitening.of(changes[:split]) * np.sqrt(at.known_K)[:, None]
        if self.film is None:
            return np.asarray(white)
        assert metric.output is not None
        return np.concatenate((white, metric.output.whitening.of(changes[split:])))

    def jacobian(self, at: Point, metric: Metric) -> Array:
        """Derivatives of both channels' whitened readings, coefficients held, (readings of both, unknowns)."""
        return self.whitened(at, metric, self.derivatives(at, metric))

    def derivatives(self, at: Point, metric: Metric) -> Array:
        """The same of the readings as they are."""
        out = np.zeros((self.rows_K.size + self.rows_dec.size, len(self.unknowns)))
        firsts = self._firsts_alone
        for k in np.flatnonzero(self.moves):
            if firsts.start <= k < firsts.stop:
                continue
            unknown = self.unknowns[k]
            step = unknown.step if at.x[k] + unknown.step <= unknown.high else -unknown.step
            x = at.x.copy()
            x[k] += step
            out[:, k] = self.change(at, metric, x, unknown.thermal) / step
        if firsts.start < firsts.stop:  # one simulation moves them all: each acts on its own stretch
            x = at.x.copy()
            x[firsts] += STEP_K
            change = self.change(at, metric, x, True) / STEP_K
            rows = np.concatenate((self.rows_K, self.rows_dec))
            stretch = np.searchsorted(self.record.first_rows, rows, side="right") - 1
            out[:, firsts] = np.where(stretch[:, None] == np.arange(self.first_degC.size), change[:, None], 0.0)
        out[:, ~np.all(np.isfinite(out), axis=0)] = 0.0  # what cannot be simulated a step away stays where it is
        return out

    @cached_property
    def _firsts_alone(self) -> slice:
        """The places of the stretches' first temperatures. Next to nothing goes from one stretch on to the next: what a
        film remembers hardly differs, and of the temperature of a body of its own two parts in a hundred."""
        if not self.driven:
            return slice(0, 0)
        first = self.place["first_degC.0"]
        return slice(first, first + self.first_degC.size)

    def residual(self, at: Point) -> Array:
        """Of both channels, whitened."""
        return np.append(at.white_K / np.sqrt(at.known_K), at.white_dec)

    def projected(self, at: Point, columns: Array) -> Array:
        """Inner products of whitened columns (readings of both, k) and the residual, with the film's active columns
        projected off: (k + 1, k + 1), the residual last."""
        split = self.rows_K.size
        every = np.column_stack((columns, self.residual(at)))
        inner = every.T @ every
        if self.film is None or self.coefficients is not None:
            return np.asarray(inner)
        active = at.design[:, at.active]
        normal = active.T @ active
        normal[np.diag_indices_from(normal)] += self.film.precision[at.active]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        normal = normal * np.outer(scale, scale)
        normal[np.diag_indices_from(normal)] += 1e-9
        mixed = (active.T @ every[split:]) * scale[:, None]
        # the coefficients' own priors pull on the residual
        mixed[:, -1] -= scale * self.film.precision[at.active] * at.coefficients[at.active]
        return np.asarray(inner - mixed.T @ cho_solve(cho_factor(normal), mixed))

    # ---- fit ----------------------------------------------------------------------------------------------------

    def _share(self, x: Array) -> tuple[float, Array]:
        """How far R_e / S is from what modules have, in deviations, and its gradient."""
        gradient = np.zeros(x.size)
        if "r" not in self.place:
            return 0.0, gradient
        i, j = self.place["s"], self.place["r"]
        pump = 300.0 * x[i] / self._largest_A
        gradient[j], gradient[i] = 1.0 / (pump * SHARE[1]), -x[j] / (pump * x[i] * SHARE[1])
        return (x[j] / pump - SHARE[0]) / SHARE[1], gradient

    @cached_property
    def _largest_A(self) -> float:
        assert self.record.current_A is not None
        return max(float(np.max(np.abs(self.record.current_A))), 1e-9)

    def _share_cost(self, x: Array) -> float:
        return 0.5 * self._share(x)[0] ** 2

    def normal_equations(self, at: Point, metric: Metric) -> tuple[Array, Array]:
        """N and g of a Gauss-Newton step by the point's tangent, priors included."""
        assert at.tangent is not None
        inner = self.projected(at, self.whitened(at, metric, at.tangent[1]))
        precision = self.prior_deviation**-2.0
        away, gradient = self._share(at.x)
        normal = inner[:-1, :-1] + np.diag(precision) + np.outer(gradient, gradient)
        slope = inner[:-1, -1] - precision * (at.x - self.prior_mean) - away * gradient
        still = ~self.moves
        normal[still, :] = 0.0
        normal[:, still] = 0.0
        normal[still, still] = 1.0
        slope[still] = 0.0
        return normal, slope

    def descend(self, at: Point, metric: Metric, steps: int = STEPS, settled: float = SETTLED) -> Point:
        """The point of the least cost near another, with this noise."""

        if not self.unknowns:
            return at

        def linearized(here: Point) -> Linearized[Point]:
            if here.tangent is not None:
                normal, gradient = self.normal_equations(here, metric)
                moved_by = here.x - here.tangent[0]
            if here.tangent is None or not moved_by @ normal @ moved_by < NEAR:  # nan is far, too
                here = replace(here, tangent=(here.x, self.derivatives(here, metric)))
                normal, gradient = self.normal_equations(here, metric)
            if not np.all(np.isfinite(normal)):
                normal, gradient = np.eye(gradient.size), np.zeros(gradient.size)
            held_at_bounds(normal, gradient, here.x, self.low, self.high)
            scale = np.maximum(np.diag(normal), 1e-12 * float(np.max(np.diag(normal), initial=0.0)) + 1e-300)

            def moved(move: Array) -> Point:
                there = self.solve(np.clip(here.x + move, self.low, self.high), metric, here.known_own)
                return replace(there, tangent=here.tangent)

            return Linearized(normal, gradient, scale, moved)

        def last(before: float, after: float) -> bool:
            return before - after < settled

        return descend(at, steps, lambda point: point.cost, linearized, last, DAMPING, 0.1 * settled)

    def noise(
        self, at: Point, before: Metric, most: tuple[float, float] = (math.inf, math.inf), near: bool = False
    ) -> Metric:
        """The likeliest noise for a point's residuals. before: for the weights of readings far out; most: the largest
        discrepancy of each channel; near: the film's path is nearly that of the noise before."""
        readings, step = before.temperature.readings, self.record.step_K
        if not before.simulated:
            temperature = before.temperature
        else:
            least = max(LEAST_NOISE_K, step / math.sqrt(12.0))
            temperature = estimated_noise(
                at.residual_K, readings, np.zeros(at.residual_K.size), least, most[0], before.temperature
            )
            temperature = noise_of_instrument(at.residual_K, temperature, at.run.shown_degC[self.rows_K])
            if self.rounded:
                temperature = likelier_of_rounded(at.residual_K, step, temperature)
        if self.film is None or before.output is None:
            return before.of(temperature, None)
        error = np.hypot(self.path_error(at, temperature), self._range_error(at, before.output.noise.white))
        start = before.output
        if start.domains is not None and not near:
            start = self.in_domains(at, start, start.domains.relays, start.domains.parts)
        shown = at.shown_dec[self.rows_dec]
        output = estimated_noise(at.residual_dec, start.readings, error, LEAST_NOISE_DEC, most[1], start, shown)
        if output.domains is None:
            output = noise_of_instrument(at.residual_dec, output, shown)
        return before.of(temperature, output)

    def in_domains(self, at: Point, output: ChannelNoise, relays: Relays, parts: tuple[int, int]) -> ChannelNoise:
        """The output's noise with the discrepancy of a film in domains, along a point's path."""
        run = at.run
        assert run.nodes is not None
        columns, rest, a_part_s = domain_columns(relays, run.nodes, parts)
        for e in run.links.hysteretic_part:
            columns = columns_followed(e, run.nodes.points_s, columns)
        meter = Ohmmeter(run.links, run.nodes, run.nodes.at_points(at.own))
        shown = np.ascontiguousarray(meter.plain(columns)[self.rows_dec])
        return replace(output, domains=Domains(shown, run.nodes.of_rows(rest)[self.rows_dec], a_part_s, relays, parts))

    def _range_error(self, at: Point, white: float) -> Array:
        """What a reading may be off by because it is not known which range the ohmmeter was on, (used readings,)."""
        if not at.range_of.size:
            return np.zeros(self.rows_dec.size)
        assert at.run.nodes is not None
        assert at.run.columns is not None
        signal, reach = at.run.columns @ at.coefficients, RANGES * white
        ends = [self._shown(at.run, signal, at.range_of + side)[self.rows_dec] for side in (reach, -reach)]
        return np.abs(ends[0] - ends[1])

    def path_error(self, at: Point, temperature: ChannelNoise) -> Array:
        """Deviation of y by the error of the film's path, (used readings,), decades."""
        if temperature.noise.slow == 0.0 or temperature.of_instrument:
            return np.zeros(self.rows_dec.size)
        _, deviation = discrepancy(at.residual_K, temperature.noise, temperature.readings)
        error_K = np.interp(self.record.time_s[self.rows_dec], temperature.readings.time_s, deviation)
        temperature_at = at.run.path.at(self.record.time_s[self.rows_dec])
        rate, change = np.gradient(temperature_at), np.gradient(at.own[self.rows_dec])
        usual = float(np.median(np.abs(rate))) + 1e-9
        return np.abs(change) / np.maximum(np.abs(rate), 0.1 * usual) * error_K

    def log_likelihood(self, at: Point, metric: Metric) -> float:
        """Of a point, its parameters' priors included."""
        return sum(channel.log_scale for channel in metric.channels) - at.cost

    def fit(
        self,
        x: Array,
        metric: Metric,
        own: Array | None = None,
        rounds: int = ROUNDS,
        most: tuple[float, float] = (math.inf, math.inf),
        steps: int = STEPS,
        settled: float = SETTLED,
    ) -> Fit:
        """Parameters and noise in turn, from a start and a noise."""
        best: Fit | None = None
        at = self.solve(x, metric, own)
        for _ in range(rounds):
            at = self.descend(at, metric, steps, settled)
            if not math.isfinite(at.cost):
                break
            metric = self.noise(at, metric, most, near=best is not None or rounds == 1)
            at = replace(self.solve(at.x, metric, at.known_own), tangent=at.tangent)
            fit = Fit(self, at, metric, self.log_likelihood(at, metric), most)
            last = best is not None and fit.log_likelihood < best.log_likelihood + 0.3
            if best is None or fit.log_likelihood > best.log_likelihood:
                best = fit
            if last:
                break
        return best or Fit(self, at, metric, -math.inf)

    def readings(self) -> tuple[Readings, Readings]:
        """When the used readings of both channels were taken."""
        time, joined = self.record.time_s, self.record.joined
        begins = np.zeros(time.size, dtype=np.int64)
        begins[np.append(0, joined).astype(np.int64)] = 1
        record = np.cumsum(begins)
        return tuple(  # type: ignore[return-value]
            Readings.at(time[rows], np.diff(record[rows], prepend=0) > 0) for rows in (self.rows_K, self.rows_dec)
        )


def _begins_late(effect: Effect) -> bool:
    """Whether it is a filter behind the thermometer: nobody knows what it was behind before."""
    return isinstance(effect.form, Filter) and effect.form.target != "thermometer"


def _begins_anew(effect: Effect) -> bool:
    """Whether it has a temperature of its own at the beginning of a record: a body, or a filter of the thermometer."""
    form = effect.form
    return (isinstance(form, HeatFlow) and form.own_rate is not None) or (
        isinstance(form, Filter) and form.target == "thermometer"
    )
