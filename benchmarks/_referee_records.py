"""Records of a simulated rig with hidden causes: plate, controllers, film, instruments, and what is drawn for a seed.

A simulation of its own, in numpy alone: it shares no line with the program whose diagnoses it judges. The plate runs
by Runge-Kutta steps of 0.1 s or less, broken where the current switches; lags take the exact step of a ramp. A seed
gives the same record, to the last bit, as long as the order of the draws stays as it is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Random = np.random.Generator
Effects = dict[str, dict[str, float]]
Control = Callable[[int, float, float], float]  # (row, time, reading) -> current
Sizes = dict[str, float]  # rms by channel, in noises

ZERO_DEGC = 273.15  # K
BOLTZMANN_EV = 8.617e-5  # eV/K
BEFORE_S, AFTER_S = 8.0, 8.0  # simulated beyond the record's ends: skewed clocks read there
SLOPES_AT_DEGC = 25.0  # where the plate's numbers are given
ARRHENIUS_AT_K, HOT_DEGC = 330.0, 100.0  # where a film's activated part is 0, and its resistance is drawn
PID_TUNED_AT_K = 330.0  # amid the transitions that are drawn
RELAYS = 3000  # of a Preisach film: a smooth loop at any noise that is drawn
FAR_COLD, FAR_HOT = -270.0, 400.0  # degC, where any film is saturated
RUNS_WITHIN = (-60.0, 160.0)  # degC: a plate that leaves this is no rig
REPLAYS_WITHIN = (-200.0, 500.0)  # degC: currents replayed without an effect may go further
SHOWN_WITHIN = (5.0, 110.0)  # degC of the readings of a record
LEAST_DECADES = 0.7  # of the resistance in a record: less shows no transition
STEP_S, LONG_STEP_S, LONG_S = 0.1, 0.2, 6000.0  # of the plate; a long record is slow, too
REPLAY_STEP_S = 10.0  # sensitivities need no finer step than the rows
FAINT_RAW = 0.3  # noises: a hidden effect that changes the readings by less cannot be asked for
FAINT_REFITTED = 1.5  # noises left of an outside cause when the base model is fitted again: less cannot be told
STRENGTHENED, ATTEMPTS = 14, 30  # draws with faint causes made stronger; draws in all
PASSED = (0.02, 0.98)  # quantiles of the plate's temperatures: the transition must lie between them
MEMORY_GROUPS = 6  # by centre and by width: relays with a common sensitivity

EFFECTS = {  # the parameter that makes an effect visible: least and most visible value
    "actuator_delay": ("delay_s", 0.2, 5.0),
    "actuator_deadband": ("deadband_A", 0.02, 0.3),
    "heat_sink_warmup": ("sink_conductance_ratio_per_s", 0.5, 0.02),
    "radiative_loss": ("loss_per_K3_s", 2e-11, 5e-10),  # over the heat capacity
    "ambient_drift": ("drift_K_per_h", 0.3, 5.0),
    "sensor_lag": ("tau_s", 0.2, 30.0),
    "thermometer_quantization": ("step_K", 0.05, 0.5),
    "film_lag": ("tau_s", 0.2, 10.0),
    "self_heating": ("theta_K_per_W", 100.0, 1e4),
    "film_drift": ("drift_K_per_h", 0.1, 3.0),
    "creep": ("share", 0.02, 0.3),
    "meter_lag": ("tau_s", 0.2, 10.0),
    "timestamp_skew": ("skew_s", 0.1, 5.0),
    "series_resistance": ("series_ohm", 0.5, 500.0),
    "parallel_leakage": ("leakage_ohm", 1e9, 1e5),
    "meter_range_error": ("error", 0.002, 0.05),
}
OF_EITHER_SIGN = ("ambient_drift", "film_drift", "timestamp_skew")
ALIKE = ({"film_lag", "meter_lag", "timestamp_skew"},)  # never two of one set in a record: nothing tells them apart
OUTSIDE = {  # causes that no catalogue lists: least and most visible size
    "weak_side": (0.04, 0.25),  # share of the cooling current that is lost
    "slew": (1.0, 0.05),  # A/s that the driver follows
    "soft_driver": (0.01, 0.05),  # share lost per ampere
    "draught": (0.1, 0.5),  # share of the conductance added, now and then
    "room_cycle": (0.5, 3.0),  # K of the room's swing
    "latent": (0.2, 1.0),  # share of the heat capacity added at a temperature
    "current_pickup": (0.05, 0.5),  # K/A in the thermometer
    "wavy_scale": (0.1, 0.8),  # K of the thermometer's scale error
    "contact_jumps": (0.01, 0.1),  # decades, now and then
    "lead_pickup": (1.0, 10.0),  # ohm/A in the ohmmeter
    "fatigue": (0.003, 0.03),  # share of the step lost per 100 K of travel
    "stale_meter": (0.15, 0.4),  # share of readings that repeat the last one
    "coarse_dac": (0.1, 0.4),  # A a step of the driver
}
KINDS = {"clean": 30, "one": 40, "two": 20, "outside": 15, "other_film": 15}  # of 120 records
SLOTS = [kind for kind, count in KINDS.items() for _ in range(count)]
FIRST_SLOT = {kind: SLOTS.index(kind) for kind in KINDS}
BLOCK = 1000  # seeds with a common order of slots
RANGES = ((1.2e3, 1e-3), (1.2e4, 1e-4), (1.2e5, 1e-5), (1.2e6, 5e-6), (np.inf, 5e-7))  # ohmmeter: up to ohm, test A
RANGE_OVER = 1.2  # a range shows 20 % more than its name
REPLAY_TEST_CURRENT = 1e-5  # A where the ohmmeter's ranges would choose: no replay heats the film much


def log_uniform(rng: Random, low: float, high: float, position: float | None = None) -> float:
    """Draw log-uniformly between two values, or take the given position (0 to 1) between them."""
    return float(low * (high / low) ** (rng.random() if position is None else position))


def size_of(effects: Effects, name: str, parameter: str) -> float:
    """Return a parameter of an effect, 0 if it is not there."""
    return effects.get(name, {}).get(parameter, 0.0)


# What is hidden


@dataclass(frozen=True)
class Foreign:
    """A cause that no catalogue lists. windows: times where it comes and goes; centre, width: temperatures."""

    name: str
    size: float
    windows: list[float]
    period: float
    centre: float
    width: float

    def on(self, time: float) -> bool:
        """Return whether a cause that comes and goes is there."""
        return sum(time > edge for edge in self.windows) % 2 == 1


def draw_effect(name: str, position: float, rng: Random, capacity: float, decades: list[int]) -> dict[str, float]:
    """Draw the parameters of an effect. position: 0 to 1 in its range, 1 is the most visible end."""
    sign = 1 if rng.random() < 0.5 else -1
    parameter, faint, plain = EFFECTS[name]
    size = log_uniform(rng, faint, plain, position)
    if name in OF_EITHER_SIGN:
        return {parameter: sign * size}
    if name == "radiative_loss":
        return {parameter: size / capacity}
    if name == "heat_sink_warmup":
        return {"sink_capacity_ratio": log_uniform(rng, 3, 30), parameter: size}
    if name == "creep":
        return {parameter: size, "tau_s": log_uniform(rng, 50, 2000)}
    if name == "meter_range_error":
        return {"threshold_ohm": 10.0 ** rng.choice(decades), parameter: size}
    return {parameter: size}


def draw_foreign(name: str, position: float, rng: Random, total_s: float) -> Foreign:
    """Draw the size of a cause from outside, and when and where it acts."""
    edges = 2 * rng.integers(1, 4)
    windows = sorted(rng.uniform(0.1 * total_s, 0.9 * total_s, edges).tolist())
    return Foreign(
        name=name,
        size=log_uniform(rng, *OUTSIDE[name], position),
        windows=windows,
        period=log_uniform(rng, 200, 1200),
        centre=float(rng.uniform(45, 75)),
        width=float(rng.uniform(3, 8)),
    )


# Plate and thermometer


@dataclass(frozen=True)
class Plate:
    """Numbers of the plate, all over its heat capacity, and the room around it."""

    pumping: float
    resistance: float
    conductance: float
    pumping_slope: float
    resistance_slope: float
    ambient_degC: float = np.nan

    def document(self) -> dict[str, float]:
        """Return the numbers under the letters of the plate's law."""
        return dict(zip(("S", "R", "G", "s", "r", "Ta"), asdict(self).values(), strict=True))

    def steady_current(self, temperature: float) -> float:
        """Find the current that holds a temperature, by bisection."""
        low, high = -2.5, 6.0  # A: below is past the most cooling, above past any driver
        away = temperature - SLOPES_AT_DEGC
        for _ in range(40):
            current = (low + high) / 2
            pumped = self.pumping * (1 + self.pumping_slope * away) * current * (temperature + ZERO_DEGC)
            heat = pumped + 0.5 * self.resistance * (1 + self.resistance_slope * away) * current * current
            if heat < self.conductance * (temperature - self.ambient_degC):
                low = current
            else:
                high = current
        return current


@dataclass(frozen=True)
class Course:
    """What one record has besides the rig: its times, its room, its first temperatures, its thermometer's noise."""

    times: Floats
    read_after: Floats  # s from a row's time to the ohmmeter's reading
    current_after: float  # s from a row's time to the current's change
    ambient_degC: float
    step_s: float
    noise_K: Floats
    low_degC: float
    high_degC: float
    start: str
    start_degC: float
    history: list[float]  # temperatures that the film went through before

    @property
    def rows(self) -> int:
        return len(self.times)


class Driven:
    """A plate with the effects that change its heat flows."""

    def __init__(self, plate: Plate, effects: Effects, foreign: Foreign | None) -> None:
        self.plate, self.foreign = plate, foreign
        self.kind, self.size = (foreign.name, foreign.size) if foreign else ("", 0.0)
        self.drift = size_of(effects, "ambient_drift", "drift_K_per_h") / 3600
        self.radiation = size_of(effects, "radiative_loss", "loss_per_K3_s")
        self.has_sink = "heat_sink_warmup" in effects
        self.sink_capacity = size_of(effects, "heat_sink_warmup", "sink_capacity_ratio")
        self.sink_conductance = size_of(effects, "heat_sink_warmup", "sink_conductance_ratio_per_s")
        self.deadband = size_of(effects, "actuator_deadband", "deadband_A")

    def acting(self, commanded: float) -> float:
        """Return the current that the driver makes of a command."""
        if self.kind == "coarse_dac":
            return round(commanded / self.size) * self.size
        lost = 0.0
        if self.kind == "weak_side":
            lost = self.size * (commanded < 0)
        elif self.kind == "soft_driver":
            lost = self.size * abs(commanded)
        return 0.0 if abs(commanded) < self.deadband else commanded * (1 - lost)

    def rates(self, plate_T: float, sink_T: float, current: float, time: float) -> tuple[float, float]:
        """Return the rates of the plate's and the heat sink's temperature, K/s."""
        plate, away = self.plate, plate_T - SLOPES_AT_DEGC
        ambient, conductance = plate.ambient_degC + self.drift * max(time, 0.0), plate.conductance
        if self.foreign and self.kind == "room_cycle":
            ambient += self.size * np.sin(6.283185 * time / self.foreign.period)
        elif self.foreign and self.kind == "draught" and self.foreign.on(time):
            conductance *= 1 + self.size
        pumped = current * plate.pumping * (1 + plate.pumping_slope * away)
        joule = 0.5 * current * current * plate.resistance * (1 + plate.resistance_slope * away)
        leak = conductance * (plate_T - (sink_T if self.has_sink else ambient))
        rate = pumped * (plate_T + ZERO_DEGC) + joule - leak
        if self.radiation:
            rate -= self.radiation * ((plate_T + ZERO_DEGC) ** 4 - (ambient + ZERO_DEGC) ** 4)
        if self.foreign and self.kind == "latent":
            rate /= 1 + self.size * np.exp(-(((plate_T - self.foreign.centre) / self.foreign.width) ** 2))
        if not self.has_sink:
            return rate, 0.0
        sink_heat = -pumped * (sink_T + ZERO_DEGC) + joule + conductance * (plate_T - sink_T)
        return rate, (sink_heat - self.sink_conductance * (sink_T - ambient)) / self.sink_capacity

    def stepped(self, plate_T: float, sink_T: float, current: float, time: float, d: float) -> tuple[float, float]:
        """Return both temperatures after one Runge-Kutta step of d seconds."""
        k1, j1 = self.rates(plate_T, sink_T, current, time)
        k2, j2 = self.rates(plate_T + d / 2 * k1, sink_T + d / 2 * j1, current, time + d / 2)
        k3, j3 = self.rates(plate_T + d / 2 * k2, sink_T + d / 2 * j2, current, time + d / 2)
        k4, j4 = self.rates(plate_T + d * k3, sink_T + d * j3, current, time + d)
        return plate_T + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4), sink_T + d / 6 * (j1 + 2 * j2 + 2 * j3 + j4)


def follow_plate(
    plate: Plate, course: Course, effects: Effects, foreign: Foreign | None, drive: Control | Floats, step_s: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Run plate and thermometer, driven by a controller or by the currents of the rows. ValueError if it runs away.

    Returns fine times, plate temperatures and thermometer readings without noise there, and the rows' currents.
    """
    driven = Driven(plate, effects, foreign)
    lag_s = size_of(effects, "sensor_lag", "tau_s")
    late_s = size_of(effects, "actuator_delay", "delay_s") + course.current_after
    slews, picks_up = driven.kind == "slew", driven.kind == "current_pickup"
    coldest, hottest = RUNS_WITHIN if callable(drive) else REPLAYS_WITHIN
    edges = np.concatenate([[-BEFORE_S], course.times, [course.times[-1] + AFTER_S]]).tolist()
    plate_T, sink_T, shown = course.start_degC, course.ambient_degC, course.start_degC
    now, goal = 0.0, 0.0  # current, and where it goes
    waiting: deque[tuple[float, float]] = deque()  # (time, current) of switches to come
    commands: list[float] = []
    fine, plates, readings = [edges[0]], [plate_T], [shown]
    for k, (a, b) in enumerate(pairwise(edges)):
        if k:
            if callable(drive):
                commands.append(round(float(drive(k - 1, a, readings[-1] + course.noise_K[k - 1])), 4))
            else:
                commands.append(drive[k - 1])
            waiting.append((a + late_s, driven.acting(commands[-1])))
        time = a
        while time < b:
            while waiting and waiting[0][0] <= time + 1e-9:  # a nanosecond: rounding of the sum
                goal = waiting.popleft()[1]
            end = min(b, waiting[0][0]) if waiting else b
            steps = max(1, int(np.ceil((end - time) / step_s - 1e-9)))
            d = (end - time) / steps
            for _ in range(steps):
                move = max(-driven.size * d, min(driven.size * d, goal - now)) if slews else goal - now
                current = now + move / 2 if slews else goal
                now = now + move
                new, sink_T = driven.stepped(plate_T, sink_T, current, time, d)
                ramp = (new - plate_T) / d * lag_s
                shown = new - ramp + (shown - plate_T + ramp) * np.exp(-d / lag_s) if lag_s else new
                plate_T, time = new, time + d
                fine.append(time)
                plates.append(plate_T)
                readings.append(shown + (driven.size * now if picks_up else 0))
                if not coldest < plate_T < hottest:
                    raise ValueError("plate out of bounds")
            time = end
    scale = np.array(readings)
    if foreign and driven.kind == "wavy_scale":
        scale = scale + driven.size * np.sin(scale / foreign.width)
    return np.array(fine), np.array(plates), scale, np.array(commands)


def lagged(times: Floats, values: Floats, tau_s: float) -> Floats:
    """Return the values after a lag of first order, exact for values that run straight between the times."""
    steps = np.diff(times)
    y = values[0]
    found = [values[0]]
    shares = np.exp(-steps / tau_s).tolist()
    for a, b, dt, share in zip(values[:-1].tolist(), values[1:].tolist(), steps.tolist(), shares, strict=True):
        behind = (b - a) / dt * tau_s if dt > 0 else 0.0
        y = b - behind + (y - a + behind) * share
        found.append(y)
    return np.array(found)


# Film


@dataclass(frozen=True)
class Film:
    """A film: operators with weights, and a part without memory.

    kind: "generalized" (common envelopes), "mixed" (each operator has its own) or "preisach" (relays); mixing: exponent
    of the mixture of two phases, 0 where decades add; up, down, groups: relays; the rest: operators with radii.
    """

    kind: str
    centre: float
    width: float
    height: float
    mixing: float
    weights: Floats = field(default_factory=lambda: np.empty(0))
    form: str = ""
    constants: tuple[float, ...] = ()
    offset: float = 0.0
    up: Floats | float = 0.0
    down: Floats | float = 0.0
    groups: Any = None
    radii: Floats | float = 0.0
    steep_up: Floats | float = 0.0
    steep_down: Floats | float = 0.0
    centre_up: Floats | float = 0.0
    centre_down: Floats | float = 0.0

    def memoryless(self, T: Any) -> Any:
        """Return the part of -log10 R that follows the temperature at once."""
        c = self.constants
        if self.form == "tanh":
            return c[0] * np.tanh(c[1] * (T - c[2])) + self.offset
        if self.form == "arrhenius":
            return -c[0] / (BOLTZMANN_EV * np.log(10)) * (1 / (T + ZERO_DEGC) - 1 / ARRHENIUS_AT_K) + self.offset
        x = T - 40
        return c[0] * x + (c[1] * x * x if self.form == "polynomial" else 0) + self.offset

    def shares(self, relays: Floats) -> Floats:
        """Return what each group of relays adds to the output."""
        return np.asarray(np.bincount(self.groups, self.weights * relays, MEMORY_GROUPS**2), np.float64)


def _with_relays(rng: Random, film: Film) -> Film:
    """Draw the relays of a Preisach film: one or two clouds, wider to one side."""
    number, spread = RELAYS, rng.uniform(2, 6)
    half = film.width / 2 * np.exp(rng.normal(0, rng.uniform(0.25, 0.7), number)) / 1.1
    in_first = rng.random(number) < rng.uniform(0.6, 1)
    first = rng.normal(0, spread, number)
    second = rng.normal(rng.uniform(-8, 8), spread / 2, number)
    middle = film.centre + np.where(in_first, first, second)
    half = np.maximum(half * (1 + rng.uniform(-0.3, 0.3) * (middle - film.centre) / spread / 2), 0.1)
    weights = np.exp(rng.normal(0, 0.3, number))

    def sixth(values: Floats) -> Any:
        return np.argsort(np.argsort(values)) * MEMORY_GROUPS // number

    groups = sixth(middle) * MEMORY_GROUPS + sixth(half)
    weights = weights * film.height / weights.sum()
    return replace(film, weights=weights, up=middle + half, down=middle - half, groups=groups)


def _with_operators(rng: Random, film: Film) -> Film:
    """Draw the play operators of a film, and the tanh envelopes before them."""
    number, steep, apart = int(rng.integers(8, 61)), rng.uniform(0.08, 0.3), film.width * rng.uniform(0.2, 0.6)
    widest = np.clip((film.width - apart) * steep, 0.1, 0.95)
    radii = np.sort(rng.uniform(0.01, widest, number))
    weights = rng.gamma(1.5, 1, number)
    weights = weights * np.exp(-radii / widest * rng.uniform(0, 3))
    weights *= film.height / (2 * weights * (1 - radii)).sum()
    film = replace(
        film,
        weights=weights,
        radii=radii,
        steep_up=steep,
        steep_down=steep * rng.uniform(0.88, 1.14),
        centre_up=film.centre + apart / 2,
        centre_down=film.centre - apart / 2,
    )
    if film.kind != "mixed":
        return film
    shift = rng.normal(0, rng.uniform(1, 4), number)
    return replace(
        film,
        steep_up=film.steep_up * np.exp(rng.normal(0, 0.25, number)),
        steep_down=film.steep_down * np.exp(rng.normal(0, 0.25, number)),
        centre_up=film.centre_up + shift,
        centre_down=film.centre_down + shift,
    )


def draw_film(rng: Random, other: bool) -> Film:
    """Draw a film like the model's, or another one."""
    kind, mixing = "generalized", 0.0
    centre, width, height = rng.uniform(45, 85), log_uniform(rng, 2, 15), rng.uniform(1.3, 3.6)
    if other:
        kind = str(rng.choice(["preisach", "preisach", "mixed"]))
        mixing = rng.uniform(0.1, 0.4) if rng.random() < 0.4 else 0.0
    relays = kind == "preisach"
    film = Film(kind, centre, width, height, mixing)
    film = (_with_relays if relays else _with_operators)(rng, film)
    form = str(rng.choice(["tanh", "linear", "polynomial", "arrhenius"]))
    top = -rng.uniform(1.4, 2.6)  # -log10 R of the hot film
    constants: dict[str, tuple[float, ...]] = {
        "tanh": (rng.uniform(0.1, 0.5), rng.uniform(0.02, 0.05), rng.uniform(40, 70)),
        "linear": (rng.uniform(0.001, 0.012),),
        "polynomial": (rng.uniform(0.003, 0.012), -rng.uniform(1e-5, 5e-5)),
        "arrhenius": (rng.uniform(0.03, 0.28),),  # eV
    }
    film = replace(film, form=form, constants=constants[form])
    return replace(film, offset=top - film.memoryless(HOT_DEGC) - (height if relays else height / 2))


class Memory:
    """The film's memory, moved by temperatures one after the other."""

    def __init__(self, film: Film, history: Sequence[float]) -> None:
        hot = history[0] > film.centre
        self.film, self.relays = film, film.kind == "preisach"
        self.temperature = FAR_HOT if hot else FAR_COLD
        if self.relays:
            self.states: Floats = np.full(len(film.weights), float(hot))
        else:
            self.states = np.asarray(1 - film.radii if hot else film.radii - 1)
        for T in history:
            self.move(T)

    def at(self, T: float) -> Floats:
        """Return the operators' states if the temperature goes to T."""
        film, before = self.film, self.states
        rising = self.temperature < T
        if self.relays:
            return np.where(film.up <= T, 1.0, before) if rising else np.where(film.down >= T, 0.0, before)
        if rising:
            return np.maximum(np.tanh(film.steep_up * (T - film.centre_up)) - film.radii, before)
        if self.temperature > T:
            return np.minimum(np.tanh(film.steep_down * (T - film.centre_down)) + film.radii, before)
        return before

    def move(self, T: float) -> None:
        """Go to a temperature."""
        self.states, self.temperature = self.at(T), T

    def output(self, states: Floats) -> float:
        """Return the part of -log10 R with memory."""
        film, found = self.film, float(np.dot(self.film.weights, states))
        if film.mixing:
            low = 0.0 if self.relays else -film.height / 2
            hot_share = (found - low) / film.height
            found = low + np.log10(1 + hot_share * (10 ** (film.mixing * film.height) - 1)) / film.mixing
        return found


def test_current_of_range(ohm: float) -> float:
    """Return the test current of an ohmmeter that chooses its range."""
    return next(current for limit, current in RANGES if not ohm >= limit)


def _follow_quickly(film: Film, memory: Memory, base: Floats, keep: bool) -> tuple[Floats, list[Floats]]:
    """Follow a film with common envelopes, which are computed at once: the same steps as Memory's."""
    up = np.tanh(film.steep_up * (base - film.centre_up)).tolist()
    down = np.tanh(film.steep_down * (base - film.centre_down)).tolist()
    moves = np.sign(np.diff(base, prepend=base[0])).tolist()
    states, radii, weights = memory.states, film.radii, film.weights
    output, kept = np.empty(len(base)), []
    for i, move in enumerate(moves):
        if move > 0:
            states = np.maximum(up[i] - radii, states)
        elif move < 0:
            states = np.minimum(down[i] + radii, states)
        output[i] = weights.dot(states)
        if keep:
            kept.append(states)
    return output, kept


def _heated(film: Film, memory: Memory, base: float, gain: float, guess: float | None) -> float:
    """Solve for the temperature that a film takes at its own Joule heat: R falls with T, so there is one root."""

    def heat(T: float) -> float:
        return float(gain * 10 ** -(memory.output(memory.at(T)) + film.memoryless(T)))

    low, high = base, base + heat(base)
    guess = high if guess is None else min(max(guess, low), high)
    was, last = guess, np.nan
    for k in range(40):
        error = guess - base - heat(guess)
        if error > 0:
            high = guess
        else:
            low = guess
        if high - low < 1e-6 or abs(error) < 1e-6:  # K
            break
        secant = k and error != last
        step = guess - error * (guess - was) / (error - last) if secant else guess - error / 2
        was, last = guess, error
        guess = step if low < step < high else (low + high) / 2
    return guess


def follow_film(
    film: Film,
    course: Course,
    effects: Effects,
    foreign: Foreign | None,
    fine: Floats,
    plate: Floats,
    test_currents: Floats | None,
    keep: bool = False,
) -> tuple[Floats, Floats, Floats]:
    """Run the film along the plate's temperatures. test_currents: None where the ohmmeter's ranges choose them.

    Returns -log10 of its resistance at the fine times, the rows' test currents, and the operators' states if kept.
    """
    rows = course.rows
    base = plate + size_of(effects, "film_drift", "drift_K_per_h") / 3600 * np.maximum(fine, 0)
    if "film_lag" in effects:
        base = base - plate + lagged(fine, plate, effects["film_lag"]["tau_s"])
    theta = size_of(effects, "self_heating", "theta_K_per_W")
    memory = Memory(film, [*course.history, base[0]])
    used = np.zeros(rows) if test_currents is None else test_currents
    reached = base.copy()
    if not theta and film.kind == "generalized":
        output, states = _follow_quickly(film, memory, base, keep)
    else:
        output, states = np.empty(len(fine)), []
        row = np.searchsorted(course.times, fine - 1e-9)
        ohm = 10 ** -(memory.output(memory.states) + film.memoryless(base[0]))
        test = test_current_of_range(ohm) if test_currents is None else used[0]
        for i in range(len(fine)):
            if theta:
                if i and row[i] != row[i - 1]:
                    test = test_current_of_range(ohm) if test_currents is None else used[min(row[i], rows - 1)]
                if test_currents is None and row[i] < rows:
                    used[row[i]] = test
                guess = reached[i - 1] + base[i] - base[i - 1] if i else None
                reached[i] = _heated(film, memory, base[i], theta * test**2, guess)
            memory.move(reached[i])
            output[i] = memory.output(memory.states)
            if theta:
                ohm = 10 ** -(output[i] + film.memoryless(reached[i]))
            if keep:
                states.append(film.shares(memory.states) if memory.relays else memory.states)
    if "creep" in effects:
        output = output + effects["creep"]["share"] * (lagged(fine, output, effects["creep"]["tau_s"]) - output)
    if foreign and foreign.name == "fatigue":
        travel = np.cumsum(np.abs(np.diff(reached, prepend=reached[0])))
        output = output * (1 - foreign.size * travel / 100)
    return output + film.memoryless(reached), used, np.array(states)


# Ohmmeter


def ohmmeter(
    course: Course, effects: Effects, foreign: Foreign | None, fine: Floats, output: Floats, currents: Floats
) -> Floats:
    """Return log10 of the ohmmeter's reading of each row, without noise."""
    ohm = 10**-output + size_of(effects, "series_resistance", "series_ohm")
    if "parallel_leakage" in effects:
        ohm = 1 / (1 / ohm + 1 / effects["parallel_leakage"]["leakage_ohm"])
    x: Floats = np.log10(ohm)
    if "meter_lag" in effects:
        x = lagged(fine, x, effects["meter_lag"]["tau_s"])
    x = np.interp(course.times + course.read_after - size_of(effects, "timestamp_skew", "skew_s"), fine, x)
    if "meter_range_error" in effects:
        error = effects["meter_range_error"]
        x = x + np.log10(1 + error["error"]) * (x > np.log10(error["threshold_ohm"]))
    if foreign is None:
        return x
    if foreign.name == "lead_pickup":
        return np.asarray(np.log10(np.maximum(10**x + foreign.size * currents, 1e-3)))  # an ohmmeter shows no less
    if foreign.name == "contact_jumps":
        return x + foreign.size * np.array([foreign.on(time) for time in course.times])
    if foreign.name == "stale_meter":
        stale = np.random.default_rng(int(foreign.period * 1e6)).random(len(x)) < foreign.size
        return np.asarray(x[np.maximum.accumulate(np.where(stale, 0, np.arange(len(x))))])
    return x


@dataclass(frozen=True)
class Readings:
    """Thermometer and log10 R of the rows, without the ohmmeter's noise; what drove them; the plate underneath."""

    temperature: Floats
    log_ohm: Floats
    currents: Floats
    test_currents: Floats
    plate: Floats


@dataclass
class Rig:
    """A plate, a film, and instruments with their habits."""

    capacity: float  # J/K
    plate: Plate
    film: Film
    most_A: float
    noise_K: float
    digits: int
    noise_dec: float
    noise_slope: float  # factor of the ohmmeter's noise a decade
    counts: float
    period_s: float
    clock: str
    testing: str  # what chooses the test current
    overrange: bool
    every: int  # rows to a reading of the ohmmeter
    has_test_currents: bool
    has_reading_times: bool
    has_late_currents: bool
    has_ambient: bool

    def noise_at(self, log_ohm: Floats) -> Floats:
        """Return the ohmmeter's noise in decades, by range."""
        above_kilohm = np.floor(log_ohm - np.log10(RANGE_OVER)) + 1 - 3
        return np.asarray(self.noise_dec * self.noise_slope**above_kilohm)

    def placed(self, course: Course) -> Plate:
        """Return the plate in the record's room."""
        return replace(self.plate, ambient_degC=course.ambient_degC)


def read_out(
    rig: Rig,
    course: Course,
    effects: Effects,
    foreign: Foreign | None,
    drive: Control | Floats,
    test_currents: Floats | None,
) -> Readings:
    """Run plate, film and instruments through a record."""
    fine, plate, shown, currents = follow_plate(rig.placed(course), course, effects, foreign, drive, course.step_s)
    output, used, _ = follow_film(rig.film, course, effects, foreign, fine, plate, test_currents)
    temperature = np.interp(course.times, fine, shown) + course.noise_K
    if "thermometer_quantization" in effects:
        step = effects["thermometer_quantization"]["step_K"]
        temperature = np.round(temperature / step) * step
    return Readings(temperature, ohmmeter(course, effects, foreign, fine, output, currents), currents, used, plate)


# Rig, record, controllers


def draw_rig(rng: Random, other_film: bool) -> Rig:
    """Draw a rig. The order of the fields is the order of the draws."""
    capacity, slopes = log_uniform(rng, 3, 60), rng.random() < 0.5
    plate = Plate(
        pumping=rng.uniform(0.03, 0.06) / capacity,
        resistance=rng.uniform(1, 3) / capacity,
        conductance=rng.uniform(0.3, 0.8) / capacity,
        pumping_slope=rng.uniform(0.001, 0.003) if slopes else 0.0,
        resistance_slope=rng.uniform(0.0035, 0.0045) if slopes else 0.0,
    )
    noise = log_uniform(rng, 0.003, 0.04)
    return Rig(
        capacity=capacity,
        plate=plate,
        film=draw_film(rng, other_film),
        most_A=rng.uniform(4, 6),
        noise_K=noise,
        digits=4 if noise < 0.006 else 3 if noise < 0.025 or rng.random() < 0.5 else 2,
        noise_dec=log_uniform(rng, 3e-4, 4e-3),
        noise_slope=rng.choice([1.0, 1.0, 1.3, 1.8, 0.6]),
        counts=rng.choice([1e5, 1e6, 1e6]),
        period_s=log_uniform(rng, 0.2, 2),
        clock=str(rng.choice(["even", "jitter", "jitter", "uneven"])),
        testing=str(rng.choice(["auto", "fixed", "changed"])),
        overrange=bool(rng.choice([0, 0, 0, 1])),
        every=int(rng.choice([1] * 9 + [2])),
        has_test_currents=rng.random() < 0.4,
        has_reading_times=rng.random() < 0.1,
        has_late_currents=rng.random() < 0.08,
        has_ambient=rng.random() < 0.15,
    )


def draw_course(rng: Random, rig: Rig, rows: int) -> Course:
    """Draw a record's times, room, range of temperatures and history."""
    period, film = rig.period_s, rig.film
    shares = {
        "even": np.ones(rows),
        "jitter": 1 + 0.1 * np.clip(rng.normal(size=rows), -3, 3),
        "uneven": rng.uniform(0.3, 1.7, rows),
    }[rig.clock]
    times = np.round(np.cumsum(period * shares) - period * shares[0], 3)
    read_after = np.zeros(rows)
    if rig.has_reading_times:
        read_after = np.round(rng.uniform(0.02, 0.3 * min(period, 1)) + rng.uniform(0, 0.02, rows), 3)
    current_after = round(rng.uniform(0.1, 0.9) * period, 3) if rig.has_late_currents else 0.0
    ambient = rng.uniform(18, 29)
    quicker = np.clip(rig.capacity / 30, 0.3, 1)  # a small plate takes finer steps
    noise = rng.normal(0, rig.noise_K, rows)
    low_wall, high_wall = film.centre - film.width / 2, film.centre + film.width / 2
    low = max(low_wall - rng.uniform(10, 28), 12)
    high = min(high_wall + rng.uniform(8, 20), 106)
    start = str(rng.choice(["cold", "cold", "hot", "middle"]))
    if start == "cold":
        start_degC, history = ambient + rng.uniform(-0.5, 0.5), [0.0]
    elif start == "hot":
        start_degC, history = high - rng.uniform(0, 5), [130.0]
    else:
        history = [float(rng.choice([0.0, 130.0]))]
        history += rng.uniform(low_wall, high_wall, 2 * rng.integers(1, 3)).tolist()
        start_degC = rng.uniform(low_wall - 2, high_wall + 2)
    return Course(
        times=times,
        read_after=read_after,
        current_after=current_after,
        ambient_degC=ambient,
        step_s=(STEP_S if times[-1] < LONG_S else LONG_STEP_S) * quicker,
        noise_K=noise,
        low_degC=low,
        high_degC=high,
        start=start,
        start_degC=start_degC,
        history=history,
    )


def _open_loop(rng: Random, kind: str, plate: Plate, course: Course) -> Control:
    """Draw currents held for a while: up and down some stairs, or anywhere in the range."""
    low, high, total = course.low_degC, course.high_degC, course.times[-1]
    dwell = max(log_uniform(rng, 15, 150), total / 120)
    stairs = np.linspace(low, high, int(rng.integers(4, 10)))
    levels: list[tuple[float, float]] = []  # temperature, seconds
    while sum(seconds for _, seconds in levels) < total + 1:
        if kind == "stairs":
            i = len(levels) % (2 * len(stairs) - 2)
            level = stairs[i if i < len(stairs) else 2 * len(stairs) - 2 - i]
            levels.append((level + rng.normal(0, 1), dwell))
        else:
            levels.append((rng.uniform(low, high), rng.uniform(0.3, 1.7) * dwell))
    currents = [
        round(plate.steady_current(T) + (0 if rng.random() < 0.9 else rng.uniform(-0.3, 0.3)), 2) for T, _ in levels
    ]
    if rng.random() < 0.4:
        currents = [current if rng.random() < 0.85 else 0.0 for current in currents]
    ends = np.cumsum([seconds for _, seconds in levels])
    return lambda k, time, reading: currents[int(np.searchsorted(ends, time, side="right"))]


def _bang_bang(rng: Random, plate: Plate, course: Course) -> Control:
    """Draw a controller that heats to one temperature and cools to the next."""
    low, high = course.low_degC, course.high_degC
    fifth, middle = (high - low) / 5, (low + high) / 2
    on, off = plate.steady_current(high) * rng.uniform(1.1, 1.5), rng.choice([0.0, -0.5, -1.0])
    heating, until_hot, until_cold = True, high, low

    def control(k: int, time: float, reading: float) -> float:
        nonlocal heating, until_hot, until_cold
        if heating and reading > until_hot:
            heating, until_cold = False, max(rng.uniform(low, middle + fifth), plate.ambient_degC + 4)
        elif not heating and reading < until_cold:
            turn = rng.uniform(middle - fifth, high) if rng.random() < 0.6 else high
            heating, until_hot = True, max(turn, until_cold + 3)
        return on if heating else float(off)

    return control


def _setpoints(rng: Random, kind: str, course: Course) -> Floats:
    """Draw a profile of setpoints: ramps or steps between turning points, or swings that shrink."""
    low, high, total, times = course.low_degC, course.high_degC, course.times[-1], course.times
    span, middle = high - low, (low + high) / 2
    rate = min(log_uniform(rng, max(0.05, min(4 * span / total, 0.5)), 0.7), 0.8)  # K/s
    knots, at, T, half, up = [(0.0, course.start_degC)], 0.0, course.start_degC, span / 2, True
    while at < total + 1:
        if kind == "damped":
            goal = middle + (half if up else -half)
        else:
            goal = rng.uniform(middle - span / 6, high) if up else rng.uniform(low, middle + span / 6)
            if len(knots) < 5:  # the whole loop comes first
                goal = high if up else low
        at = at + abs(goal - T) / (rate * rng.uniform(0.6, 1.4))
        knots.append((at, goal))
        if rng.random() < 0.6:
            at = at + log_uniform(rng, 5, 60)
            knots.append((at, goal))
        T, up, half = goal, not up, half * 0.9 if half > span / 10 else span / 2
    knot_s, knot_T = np.array(knots).T
    if kind == "pid_steps":
        profile = knot_T[np.minimum(np.searchsorted(knot_s, times), len(knot_T) - 1)]
    else:
        profile = np.interp(times, knot_s, knot_T)
    return np.asarray(np.round(profile, 2))


def _pid(rng: Random, rig: Rig, setpoints: Floats, slowness_s: float) -> Control:
    """Draw a PID controller as fast as the loop's delays allow; its current is limited, sometimes its rate, too."""
    most = round(rig.most_A, 2)
    crossover = min(0.4, 0.35 / slowness_s) * rng.uniform(0.5, 1)  # 1/s
    kp = crossover / (rig.plate.pumping * PID_TUNED_AT_K)
    ki, kd = kp * crossover / 4, kp * rng.choice([0, 0, 0.3])
    jump = rng.choice([99.0, 99.0, 2.0, 0.8])  # A/s
    integral, current, before = 0.0, 0.0, 0.0
    last_error: float | None = None

    def control(k: int, time: float, reading: float) -> float:
        nonlocal integral, current, before, last_error
        error, dt = setpoints[k] - reading, time - before if k else 0.0
        wanted = kp * error + integral
        if last_error is not None and dt > 0:
            wanted += kd * (error - last_error) / dt / (1 + 2 * crossover)
        given = min(max(wanted, -most * 0.6), most)
        if k:
            given = min(max(given, current - jump * dt), current + jump * dt)
        elif jump < 50:  # one of limited rate begins at nothing, of the sign that it wants
            given *= 0
        if abs(wanted - given) < 1e-9:
            integral += ki * error * dt
        before, current, last_error = time, given, error
        return float(given)

    return control


def draw_control(rng: Random, rig: Rig, course: Course, effects: Effects) -> tuple[str, Control, Floats | None]:
    """Draw a controller: its kind, itself, and the setpoints of the rows (None in open loop)."""
    kind = str(rng.choice(["pid_steps", "ramps", "ramps", "damped", "bang", "stairs", "steps"]))
    plate = rig.placed(course)
    if kind in ("stairs", "steps"):
        return kind, _open_loop(rng, kind, plate, course), None
    if kind == "bang":
        return kind, _bang_bang(rng, plate, course), None
    slowness = size_of(effects, "actuator_delay", "delay_s") + size_of(effects, "sensor_lag", "tau_s")
    setpoints = _setpoints(rng, kind, course)
    return kind, _pid(rng, rig, setpoints, slowness + course.current_after + rig.period_s), setpoints


def draw_test_currents(rng: Random, rig: Rig, course: Course) -> Floats | None:
    """Draw the test currents of the rows, None if the ohmmeter's ranges choose them while the record runs."""
    if rig.testing == "auto":
        return None
    changed = rig.testing == "changed"
    current = float(f"{10 ** rng.uniform(-4.7, -3.7 if changed else -3.4):.2g}")
    switched = np.floor(course.times / rng.uniform(100, 400)) % 2 if changed else np.zeros(course.rows)
    return np.asarray(current * 3.0**switched)


def draw_columns(
    rng: Random, rig: Rig, course: Course, read: Readings, test_currents: Floats | None, setpoints: Floats | None
) -> dict[str, Floats]:
    """Draw what the log file shows: noise, rounding, overrange, outliers, missing readings, gaps."""
    rows = course.rows
    x = read.log_ohm + rng.normal(size=rows) * rig.noise_at(read.log_ohm)
    ohm, temperature = 10**x, read.temperature.copy()
    span = 10 ** np.ceil(np.log10(np.maximum(ohm, 1) / RANGE_OVER))
    ohm = np.round(ohm / span * rig.counts) * span / rig.counts
    over = RANGE_OVER * 10 ** np.floor(np.quantile(x, 0.8))
    if rig.overrange and np.mean(ohm > over) < 0.35:
        ohm[ohm > over] = np.inf
    if rng.random() < 0.4:
        for _ in range(rng.integers(1, 1 + rows // 400)):
            k, thermal, sign = rng.integers(rows), rng.random() < 0.5, rng.choice([-1, 1])
            kelvins, decades = sign * rng.uniform(0.5, 8), sign * rng.uniform(0.05, 1)
            if thermal:
                temperature[k] += kelvins
            else:
                ohm[k] *= 10**decades
    if rig.every > 1:
        ohm[np.arange(rows) % rig.every > 0] = np.nan
    if test_currents is None:
        test_currents = np.array([test_current_of_range(one) for one in 10 ** np.append(x[0], x[:-1])])
    columns: dict[str, Floats] = {
        "time_s": course.times,
        "temperature_degC": np.round(temperature, rig.digits),
        "resistance_ohm": ohm,
        "current_A": read.currents,
    }
    if rig.has_test_currents:
        columns["meter_current_A"] = test_currents
    if setpoints is not None and rig.capacity % 1 < 0.7:  # 70 % of the rigs log them
        columns["setpoint_degC"] = setpoints
    if rig.has_reading_times:
        columns["resistance_time_s"] = np.round(course.times + course.read_after, 3)
    if rig.has_late_currents:
        columns["current_time_s"] = np.round(course.times + course.current_after, 3)
    if rig.has_ambient:
        columns["ambient_degC"] = np.round(course.ambient_degC + rng.normal(0, 0.05, rows), 2)
    keep = np.ones(rows, bool)
    if rng.random() < 0.25:
        for _ in range(rng.integers(1, 4)):
            first = rng.integers(rows // 10, 9 * rows // 10)
            keep[first : first + rng.integers(4, 40)] = False
    return {name: values[keep] for name, values in columns.items()}


# Visibility


def base_sensitivities(rig: Rig, course: Course, currents: Floats, test_currents: Floats) -> Floats:
    """Return how both channels, in noises, depend on each parameter of the model without effects (unit columns)."""
    plate, film = rig.placed(course), rig.film

    def temperatures(plate: Plate, warmer: float = 0.0) -> Floats:
        start = replace(course, start_degC=course.start_degC + warmer)
        fine, temperature, _, _ = follow_plate(plate, start, {}, None, currents, REPLAY_STEP_S)
        return np.interp(course.times, fine, temperature)

    def run(film: Film, T: Floats) -> tuple[Floats, Floats]:
        output, _, states = follow_film(film, course, {}, None, course.times, T, test_currents, keep=True)
        return -output, states

    T = temperatures(plate)
    x, states = run(film, T)
    noise_x = rig.noise_at(x)
    plates = [replace(plate, **{k: getattr(plate, k) * 1.002}) for k in ("pumping", "resistance", "conductance")]
    plates.append(replace(plate, ambient_degC=plate.ambient_degC + 0.05))
    plates += [replace(plate, **{k: getattr(plate, k) + 2e-5}) for k in ("pumping_slope", "resistance_slope")]
    trials = [(film, temperatures(one)) for one in plates] + [(film, temperatures(plate, 0.05))]
    shifts = {"steep_up": 1e-3, "steep_down": 1e-3, "centre_up": 0.01, "centre_down": 0.01}
    if film.kind == "preisach":
        shifts = {"up": 0.2, "down": 0.2}  # K: enough for some of the relays to switch at another row
    trials += [(replace(film, **{k: getattr(film, k) + shift}), T) for k, shift in shifts.items()]
    found = [np.concatenate([(T1 - T) / rig.noise_K, (run(film1, T1)[0] - x) / noise_x]) for film1, T1 in trials]
    background = [((T - 60) / 30) ** k for k in range(5)]
    found += [np.concatenate([0 * T, w / noise_x]) for w in [*states.T, *background]]
    matrix = np.array(found).T
    return np.asarray(matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-12))


def visibility(sensitivities: Floats, rig: Rig, having: Readings, lacking: Readings) -> tuple[Sizes, Sizes]:
    """Return by how many noises a cause changes each channel: as it is, and with the base model fitted again."""
    thermal = (having.temperature - lacking.temperature) / rig.noise_K
    change = np.concatenate([thermal, (having.log_ohm - lacking.log_ohm) / rig.noise_at(lacking.log_ohm)])
    left = change - sensitivities @ np.linalg.lstsq(sensitivities, change, rcond=1e-9)[0]

    def sizes(values: Floats) -> Sizes:
        first, second = values[: len(values) // 2], values[len(values) // 2 :]
        return {
            "temperature_K": float(np.sqrt(np.mean(first**2))),
            "resistance_dec": float(np.sqrt(np.mean(second**2))),
        }

    return sizes(change), sizes(left)


# A record and its truth


def hidden(seed: int) -> tuple[str, list[str], str | None]:
    """Return the kind of a seed's record, the names of its effects, and a cause from outside."""
    block, i = divmod(seed - 1, BLOCK)
    of, names = len(SLOTS), list(EFFECTS)
    slot = int(np.random.default_rng([77, block, i // of]).permutation(of)[i % of])
    kind, rng = SLOTS[slot], np.random.default_rng([78, seed])
    place = slot - FIRST_SLOT[kind]
    if kind == "one":
        return kind, [names[(place + 8 * block) % len(names)]], None
    if kind == "two":
        first = names[(place + 5 * block) % len(names)]
        while True:
            second = str(rng.choice([name for name in names if name != first]))
            if not any({first, second} <= alike for alike in ALIKE):
                return kind, [first, second], None
    if kind == "outside":
        return kind, [], list(OUTSIDE)[(place + 2 * block) % len(OUTSIDE)]
    if kind == "other_film" and slot % 2:
        return kind, [str(rng.choice(names))], None
    return kind, [], None


def _suited(rig: Rig, names: list[str], foreign: str | None) -> None:
    """Take from a rig the columns that would tell what is hidden, and give it those without which none can."""
    rig.has_ambient &= "ambient_drift" not in names and foreign != "room_cycle"
    rig.has_reading_times &= "timestamp_skew" not in names
    rig.has_late_currents &= "actuator_delay" not in names
    rig.has_test_currents |= "self_heating" in names
    if "thermometer_quantization" in names:
        rig.noise_K, rig.digits = min(rig.noise_K, 0.03), max(rig.digits, 3)


def _decades(film: Film) -> list[int]:
    """Return the whole decades that the film's resistance passes."""
    ends = []
    for T in (film.centre - film.width - 8, film.centre + film.width + 8):
        memory = Memory(film, [T])
        ends.append(memory.output(memory.states) + film.memoryless(T))
    return [k for k in range(2, 8) if -ends[1] + 0.3 < k < -ends[0] - 0.3] or [3]


def _shows_a_transition(read: Readings, film: Film) -> bool:
    """Return whether a record stays within bounds and passes the film's transition."""
    coldest, hottest = SHOWN_WITHIN
    low, high = np.quantile(read.plate, PASSED)
    shown = coldest <= read.temperature.min() and read.temperature.max() <= hottest
    return bool(shown and np.ptp(read.log_ohm) >= LEAST_DECADES and low < film.centre - 1 < high - 2)


def draw(seed: int) -> tuple[dict[str, Floats], dict[str, Floats] | None, dict[str, Any]]:
    """Draw a seed's record, perhaps one to hold out, and the truth.

    A faint cause is made stronger; a record without a transition is drawn again.
    """
    kind, names, foreign_name = hidden(seed)
    causes = [*names, foreign_name] if foreign_name else names
    position = dict(zip(causes, np.random.default_rng([79, seed]).random(3), strict=False))
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([80, seed, attempt])
        rig = draw_rig(rng, kind == "other_film")
        _suited(rig, names, foreign_name)
        rows = int(max(log_uniform(rng, 2500, 8000), min(8000, 700 / rig.period_s)))
        decades = _decades(rig.film)
        effects = {name: draw_effect(name, position[name], rng, rig.capacity, decades) for name in names}
        foreign = None
        if foreign_name:
            foreign = draw_foreign(foreign_name, position[foreign_name], rng, rows * rig.period_s)
        raw: dict[str, Sizes] = {}
        refitted: dict[str, Sizes] = {}
        tables = []
        try:
            for part in range(2 if rng.random() < 0.35 else 1):
                course = draw_course(rng, rig, int(rows * rng.uniform(0.5, 0.8)) if part else rows)
                control, drive, setpoints = draw_control(rng, rig, course, effects)
                testing = draw_test_currents(rng, rig, course)
                read = read_out(rig, course, effects, foreign, drive, testing)
                if "self_heating" in effects:
                    testing = read.test_currents
                if not _shows_a_transition(read, rig.film):
                    raise ValueError("no transition")
                tables.append(draw_columns(rng, rig, course, read, testing, setpoints))
                if part == 0:
                    main = (course, control, read, testing)
            course, control, read, testing = main
            replayed = np.full(course.rows, REPLAY_TEST_CURRENT) if testing is None else testing
            if causes:
                sensitivities = base_sensitivities(rig, course, read.currents, replayed)
            for cause in causes:
                rest = {name: sizes for name, sizes in effects.items() if name != cause}
                without = read_out(rig, course, rest, None, read.currents, replayed)
                raw[cause], refitted[cause] = visibility(sensitivities, rig, read, without)
        except ValueError:  # of the plate, of the check, or of numpy where a drawn range is empty
            continue
        faint = [name for name in names if max(raw[name].values()) < FAINT_RAW]
        if foreign_name and max(refitted[foreign_name].values()) < FAINT_REFITTED:
            faint.append(foreign_name)
        if faint and attempt < STRENGTHENED:
            for name in faint:
                position[name] += (1 - position[name]) * rng.uniform(0.2, 0.8)
            continue
        film = rig.film
        shape = {"kind": film.kind, "H": film.height, "W": film.width, "centre": film.centre, "q": film.mixing}
        truth = {
            "kind": kind,
            "effects": effects,
            "seed": seed,
            "invisible": faint,
            "visibility": raw,
            "visibility_refit": refitted,
            "notes": {
                "attempt": attempt,
                "outside": asdict(foreign) if foreign else None,
                "control": control,
                "start": course.start,
                "capacity_J_per_K": rig.capacity,
                "plate": rig.placed(course).document(),
                "noise_K": rig.noise_K,
                "noise_dec": rig.noise_dec,
                "film": {**shape, "form": film.form, "operators": len(film.weights)},
            },
        }
        return tables[0], tables[1] if len(tables) > 1 else None, truth
    raise RuntimeError(f"seed {seed}: no record in {ATTEMPTS} draws")
