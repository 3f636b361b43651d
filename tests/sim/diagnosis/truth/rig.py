"""The whole rig: what a record would hold without noise, and the record itself."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.films import Film
from tests.sim.diagnosis.truth.heat import march
from tests.sim.diagnosis.truth.hysteresis import film_path
from tests.sim.diagnosis.truth.readings import at_the_terminals, lagged, ranged, rounded

Array = NDArray[np.float64]
Effects = dict[str, dict[str, float]]
STEP_S = 0.02  # longest step of the truth
HOUR = 3600.0


@dataclass(frozen=True)
class Plate:
    """Peltier plate: a = S/C per A s, b = R_e/C K per A^2 s, g = G/C per s, capacity only to know eps and S."""

    a: float
    b: float
    g: float
    ambient_degC: float
    start_degC: float
    capacity_J_per_K: float
    limit_A: float


@dataclass(frozen=True)
class Rig:
    """Plate, film, the effects that are hidden in it, and `outside`: faults that the catalogue does not know."""

    plate: Plate
    film: Film
    noise_K: float
    noise_dec: float
    effects: Effects = field(default_factory=dict)
    outside: dict[str, object] = field(default_factory=dict)
    order: int = 5
    step_s: float = STEP_S

    def having(self, effects: Effects) -> Rig:
        """The same rig with other effects."""
        return replace(self, effects=effects)

    def get(self, name: str, parameter: str, default: float = 0.0) -> float:
        """A parameter of an effect, or what stands for its absence."""
        return self.effects.get(name, {}).get(parameter, default)


@dataclass(frozen=True)
class Schedule:
    """Rows to be taken: times, test currents, and either setpoints (closed loop) or currents (as recorded)."""

    time: Array
    meter_A: Array
    setpoint: Array | None = None
    current: Array | None = None


@dataclass(frozen=True)
class Clean:
    """A record without noise: temperature before rounding, log10 ohm, the currents, and the plate on the fine steps."""

    temperature: Array
    log_ohm: Array
    current: Array
    fine_time: Array
    fine_plate: Array


def feedforward(plate: Plate, time: Array, setpoint: Array) -> Array:
    """The current that a plain plate needs to follow the setpoint: the root of its heat balance."""
    slope = np.diff(setpoint, append=setpoint[-1]) / np.diff(time, append=2 * time[-1] - time[-2])
    s = plate.a * (setpoint + 273.15)
    need = slope + plate.g * (setpoint - plate.ambient_degC)
    root = np.sqrt(np.maximum(s**2 + 2.0 * plate.b * need, 0.0))
    return np.clip((root - s) / plate.b, -plate.limit_A, plate.limit_A)


def gains(rig: Rig) -> tuple[float, float]:
    """PI gains slow enough for every lag of this rig."""
    wait = rig.get("actuator_delay", "delay_s") + rig.get("sensor_lag", "tau_s") + 0.5
    speed = min(0.12, 0.2 / wait)
    gain = speed / (rig.plate.a * 335.0)
    return gain, 0.2 * speed * gain


def _vectors(rig: Rig) -> tuple[Array, Array, Array]:
    p, get, out = rig.plate, rig.get, rig.outside
    kp, ki = gains(rig)
    sink = get("heat_sink_warmup", "sink_capacity_ratio")
    numbers = lambda name, default: tuple(out.get(name, default))  # type: ignore[call-overload]  # noqa: E731
    plate = np.array([p.a, p.b, p.g, p.ambient_degC, p.start_degC, p.limit_A, kp, ki])
    effects = np.array(
        [
            get("actuator_delay", "delay_s"),
            get("actuator_deadband", "deadband_A"),
            sink,
            get("heat_sink_warmup", "sink_conductance_ratio_per_s"),
            get("radiative_loss", "loss_per_K3_s"),
            get("ambient_drift", "drift_K_per_h") / HOUR,
            get("sensor_lag", "tau_s"),
            get("film_lag", "tau_s"),
            get("thermometer_quantization", "step_K"),
        ]
    )
    outside = np.array(
        [
            *numbers("room_cycling", (0.0, 1.0, 0.0)),
            *numbers("fan_stops", (1.0, 0.0, 0.0)),
            *numbers("saturating_driver", (0.0,)),
            *numbers("thermometer_bump", (0.0, 0.0, 1.0)),
            *numbers("sticking_thermometer", (0.0,)),
        ]
    )
    return plate, effects, outside


@dataclass(frozen=True)
class Thermal:
    """What driver, plate and thermometer did: all that the film's side needs, on the fine steps."""

    current: Array
    seen: Array
    fine: Array
    base: Array
    plate: Array
    row_of: Array
    taken: Array


def thermal(rig: Rig, schedule: Schedule, noise_K: Array | None = None) -> Thermal:
    """Current to temperatures; `noise_K` is what the closed loop's thermometer adds (the law sees it)."""
    time = schedule.time
    setpoint = schedule.setpoint if schedule.setpoint is not None else np.zeros(time.size)
    current = feedforward(rig.plate, time, setpoint) if schedule.current is None else schedule.current
    reading_time = np.maximum(time - rig.get("timestamp_skew", "skew_s"), time[0])
    noise = np.zeros(time.size) if noise_K is None else noise_K
    closed = schedule.current is None
    return Thermal(*march(time, setpoint, current, closed, noise, reading_time, *_vectors(rig), rig.step_s, rig.order))


def log_ohm(rig: Rig, schedule: Schedule, heat: Thermal) -> Array:
    """Temperatures to log10 of the readings at the rows, without noise."""
    get, film = rig.get, rig.film
    y = film_path(
        film.kind,
        film.table,
        film.memory(),
        film.form,
        film.d,
        heat.fine,
        heat.base + get("film_drift", "drift_K_per_h") / HOUR * heat.fine,
        get("self_heating", "theta_K_per_W") * schedule.meter_A[heat.row_of] ** 2,
        get("creep", "share"),
        get("creep", "tau_s", 1.0),
    )
    series = get("series_resistance", "series_ohm") + _contact(rig, heat.fine)
    y = at_the_terminals(y, series, get("parallel_leakage", "leakage_ohm", np.inf))
    tau = get("meter_lag", "tau_s")
    y = (lagged(heat.fine, y, tau) if tau > 0.0 else y)[heat.taken]
    if "meter_range_error" in rig.effects:
        y = ranged(y, get("meter_range_error", "threshold_ohm"), get("meter_range_error", "error"))
    return y + _interference(rig, schedule.time)


def simulate(rig: Rig, schedule: Schedule, noise_K: Array | None = None) -> Clean:
    """The record without noise."""
    heat = thermal(rig, schedule, noise_K)
    return Clean(heat.seen, log_ohm(rig, schedule, heat), heat.current, heat.fine, heat.plate)


def _contact(rig: Rig, fine: Array) -> Array | float:
    """Series resistance of a contact that loosens: its steps' times and ohms."""
    if "loose_contact" not in rig.outside:
        return 0.0
    steps, ohm = rig.outside["loose_contact"]  # type: ignore[misc]
    return np.asarray(ohm)[np.searchsorted(steps, fine, side="right")]


def _interference(rig: Rig, time: Array) -> Array:
    """What pickup or a switching joint adds to log10 of the reading."""
    out = np.zeros(time.size)
    if "pickup" in rig.outside:
        size, period, phase = rig.outside["pickup"]  # type: ignore[misc]
        out += size * np.sin(2.0 * np.pi * time / period + phase)
    if "bad_joint" in rig.outside:
        steps, size = rig.outside["bad_joint"]  # type: ignore[misc]
        out += size * (np.searchsorted(steps, time, side="right") % 2)
    return out


def record(rig: Rig, schedule: Schedule, rng: np.random.Generator) -> dict[str, Array]:
    """The columns of a record: noise on both channels, readings rounded, currents as commanded."""
    n = schedule.time.size
    noise = rig.noise_K * rng.standard_normal(n)
    noise_dec = rig.noise_dec * rng.standard_normal(n)
    clean = simulate(rig, schedule, noise)
    reading = rounded(clean.temperature + noise, rig.get("thermometer_quantization", "step_K"))
    return {
        "time_s": schedule.time.copy(),
        "temperature_degC": reading,
        "resistance_ohm": 10.0 ** (clean.log_ohm + noise_dec),
        "current_A": clean.current.copy(),
        "meter_current_A": schedule.meter_A.copy(),
    }
