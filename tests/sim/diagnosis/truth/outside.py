"""Eight faults that the catalogue does not have, each at a size that shows and that no effect of it can stand for."""

from __future__ import annotations

import numpy as np

from tests.sim.diagnosis.truth.combine import TRIES, recorded_current
from tests.sim.diagnosis.truth.draw import Bench, draw_bench
from tests.sim.diagnosis.truth.oracle import Oracle
from tests.sim.diagnosis.truth.rig import Effects

Random = np.random.Generator
OUTSIDE = (
    "loose_contact",  # a contact that loosens half-way: ohms in series come and go
    "room_cycling",  # the room's temperature swings with the air conditioning
    "pickup",  # interference on log R, aliased to a period of 20 to 200 s
    "bad_joint",  # log R jumps between two levels at random
    "sticking_thermometer",  # the reading moves only after the plate has moved by a band
    "thermometer_bump",  # the thermometer's linearization is wrong near one temperature
    "fan_stops",  # the plate's loss falls when a fan stops
    "saturating_driver",  # the driver's gain falls with the current
)
SEEN = 100.0  # log-likelihood that must be left beside the whole catalogue
MOST = 0.5  # share of it that the best single effect of the catalogue may explain


def instants(rng: Random, start: float, end: float, mean_s: float) -> np.ndarray:
    """Random instants, `mean_s` apart on average and never closer than a fifth of that."""
    gaps = mean_s * (0.2 + 0.8 * rng.exponential(size=int(3 * (end - start) / mean_s) + 8))
    at = start + np.cumsum(gaps)
    return np.concatenate(([start], at[at < end]))


def drawn_fault(rng: Random, name: str, bench: Bench, current: np.ndarray) -> object:
    """The fault's parameters, as `rig` wants them."""
    rig, end = bench.rig, float(bench.schedule.time[-1])
    span = bench.high_degC - bench.low_degC
    place = float(rng.uniform(bench.low_degC + 0.25 * span, bench.high_degC - 0.25 * span))
    if name == "loose_contact":
        steps = instants(rng, end * rng.uniform(0.4, 0.6), end, rng.uniform(40.0, 150.0))
        middle = 10.0 ** float(np.mean(rig.film.log_ohm(np.array([25.0, 100.0]))))
        ohm = middle * rng.uniform(0.03, 0.3) * rng.uniform(0.4, 1.6, steps.size + 1)
        ohm[0::2] *= 0.0 if rng.random() < 0.5 else 0.3
        ohm[0] = 0.0
        return steps, ohm
    if name == "bad_joint":
        return instants(rng, 0.1 * end, end, rng.uniform(60.0, 250.0)), rig.noise_dec * rng.uniform(4.0, 15.0)
    drawn: dict[str, tuple[float, ...]] = {
        "room_cycling": (rng.uniform(0.4, 2.0), rng.uniform(1200.0, 2400.0), rng.uniform(0.0, 6.28)),
        "pickup": (rig.noise_dec * rng.uniform(1.5, 6.0), rng.uniform(20.0, 200.0), rng.uniform(0.0, 6.28)),
        "sticking_thermometer": (max(0.03, rig.noise_K * rng.uniform(4.0, 10.0)),),
        "thermometer_bump": (rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 0.6), place, rng.uniform(1.5, 4.0)),
        "fan_stops": (rng.uniform(0.65, 0.92), end * rng.uniform(0.3, 0.5), end * rng.uniform(0.65, 0.9)),
        "saturating_driver": (float(np.max(np.abs(current))) * rng.uniform(1.2, 3.0),),
    }
    return tuple(float(value) for value in drawn[name])


def catalogue(bench: Bench) -> list[Effects]:
    """Every effect of the catalogue, small, those with a time constant at several: a fit's directions."""
    film = bench.rig.film.log_ohm(np.array([25.0, 100.0]))
    eps = 1e-10 / bench.rig.plate.capacity_J_per_K
    out: list[Effects] = [
        {"actuator_delay": {"delay_s": 0.2}},
        *({"actuator_deadband": {"deadband_A": size}} for size in (0.02, 0.05, 0.12, 0.3)),
        *(
            {"heat_sink_warmup": {"sink_capacity_ratio": ratio, "sink_conductance_ratio_per_s": share}}
            for ratio, share in ((4.0, 0.5), (10.0, 0.1), (20.0, 0.5), (25.0, 0.04))
        ),
        {"radiative_loss": {"loss_per_K3_s": eps}},
        {"ambient_drift": {"drift_K_per_h": 0.3}},
        {"sensor_lag": {"tau_s": 0.2}},
        {"film_lag": {"tau_s": 0.2}},
        {"self_heating": {"theta_K_per_W": 100.0}},
        {"film_drift": {"drift_K_per_h": 0.1}},
        *({"creep": {"share": 0.03, "tau_s": tau}} for tau in (60.0, 200.0, 600.0, 1800.0)),
        {"meter_lag": {"tau_s": 0.2}},
        {"timestamp_skew": {"skew_s": 0.1}},
        {"series_resistance": {"series_ohm": 0.02 * 10.0 ** film[1]}},
        {"parallel_leakage": {"leakage_ohm": 50.0 * 10.0 ** film[0]}},
    ]
    for k in (2, 3, 4, 5):
        if film[1] + 0.1 < k < film[0] - 0.1:
            out.append({"meter_range_error": {"threshold_ohm": 10.0**k, "error": 0.005}})
    return out


def with_fault(rng: Random, name: str, film: str = "of_class") -> tuple[Bench, object, dict[str, float]]:
    """A bench with this fault, its parameters, and what of it remains beside the catalogue."""
    for _ in range(TRIES):
        bench = draw_bench(rng, film)
        current = recorded_current(bench, {})
        fault = drawn_fault(rng, name, bench, current)
        effects = catalogue(bench)
        plain = Oracle(bench.rig, bench.schedule, current)
        change = plain.rest(plain.outside(**{name: fault}))
        size = float(change @ change)
        shares = []
        for effect in effects:
            direction = plain.rest(plain.difference(effect))
            shares.append(float(change @ direction) ** 2 / max(float(direction @ direction), 1e-12) / max(size, 1e-12))
        full = Oracle(bench.rig, bench.schedule, current, more=effects)
        left = full.evidence_of(full.outside(**{name: fault}))
        if left > SEEN and max(shares) < MOST:
            return bench, fault, {"left": left, "best_single": max(shares)}
    raise RuntimeError(f"no bench of {TRIES} shows {name}")
