"""Effects at sizes that one meets: ranges, how an effect is made weaker, and the smallest that can be found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.sim.diagnosis.truth.draw import Bench
from tests.sim.diagnosis.truth.oracle import Oracle, threshold

Parameters = dict[str, float]
Made = Callable[[str, Parameters, float], Parameters]
MARGIN = 4.0  # sizes are at least this many times the smallest that can be found
SIZES: dict[str, tuple[str, float, float]] = {
    "actuator_delay": ("delay_s", 0.2, 5.0),
    "actuator_deadband": ("deadband_A", 0.02, 0.3),
    "heat_sink_warmup": ("", 0.0, 0.0),
    "radiative_loss": ("loss_per_K3_s", 2e-11, 5e-10),  # times 1/C
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
    "parallel_leakage": ("leakage_ohm", 1e5, 1e9),
    "meter_range_error": ("error", 0.002, 0.05),
}
NAMES = (*SIZES, "memoryless_term")  # the last one only with a restricted base
SIGNED = ("ambient_drift", "film_drift", "timestamp_skew")
PARAMETERS = {"heat_sink_warmup": 2, "creep": 2, "meter_range_error": 2}
HOTTEST_K = 4.0  # self-heating is kept below this


def weaker(name: str, parameters: Parameters, factor: float) -> Parameters:
    """The same effect at `factor` times its size."""
    if name == "heat_sink_warmup":  # a better sink is a weaker effect
        return {key: value / factor for key, value in parameters.items()}
    key = SIZES[name][0]
    size = parameters[key] / factor if name == "parallel_leakage" else parameters[key] * factor
    return {**parameters, key: size}


def bounds(name: str, bench: Bench) -> tuple[float, float]:
    """The physical range on this bench."""
    _, low, high = SIZES[name]
    if name == "radiative_loss":
        return low / bench.rig.plate.capacity_J_per_K, high / bench.rig.plate.capacity_J_per_K
    if name == "self_heating":
        ohm = 10.0 ** float(bench.rig.film.log_ohm(np.array([25.0]))[0])
        return low, min(high, HOTTEST_K / (float(bench.schedule.meter_A.max()) ** 2 * ohm))
    if name == "thermometer_quantization":
        return max(low, 0.5 * MARGIN * bench.rig.noise_K), high
    return low, high


def others(name: str, rng: np.random.Generator, bench: Bench) -> Parameters | None:
    """The parameters beside the size; None where this bench cannot show the effect."""
    if name == "creep":
        return {"tau_s": float(np.exp(rng.uniform(np.log(50.0), np.log(2000.0))))}
    if name == "meter_range_error":
        film = bench.rig.film.log_ohm(np.array([25.0, bench.high_degC + 3.0]))
        inside = [10.0**k for k in (2.0, 3.0, 4.0, 5.0) if film[1] + 0.25 < k < film[0] - 0.25]
        return {"threshold_ohm": float(rng.choice(inside))} if inside else None
    return {}


def slower(name: str, parameters: Parameters, factor: float) -> Parameters:
    """The same effect at `factor` times its size, its first parameter alone: a heat sink of the same conductance."""
    if name == "heat_sink_warmup":
        return {**parameters, "sink_capacity_ratio": parameters["sink_capacity_ratio"] / factor}
    return weaker(name, parameters, factor)


def smallest(name: str, reference: Parameters, oracle: Oracle, low: float = 1e-4, made: Made = weaker) -> float:
    """The factor on the reference's size at which the oracle finds the effect half of the time (inf: not below 1).
    made: how it is made weaker."""
    wanted = threshold(PARAMETERS.get(name, 1))

    def found(factor: float) -> bool:
        return oracle.evidence({name: made(name, reference, factor)}) > wanted

    if not found(1.0):
        return float("inf")
    if name in ("sensor_lag", "film_lag"):  # a shorter lag would need a finer step, and is no lag any more
        low = 0.01 / reference["tau_s"]
    below, above = low, 1.0
    while above / below > 1.04:
        middle = float(np.sqrt(above * below))
        below, above = (below, middle) if found(middle) else (middle, above)
    return above


def sized(name: str, rng: np.random.Generator, bench: Bench, oracle: Oracle) -> tuple[Parameters, float] | None:
    """The effect at a size drawn log-uniformly from its range above four times the smallest, and that smallest as a
    share of the drawn size; None where this bench cannot show it."""
    rest = others(name, rng, bench)
    if rest is None:
        return None
    if name == "heat_sink_warmup":
        drawn = {
            "sink_capacity_ratio": float(np.exp(rng.uniform(np.log(3.0), np.log(30.0)))),
            "sink_conductance_ratio_per_s": float(np.exp(rng.uniform(np.log(0.02), np.log(0.5)))),
        }
        share = smallest(name, drawn, oracle)
        return (drawn, share) if share <= 1.0 / MARGIN else None
    key = SIZES[name][0]
    low, high = bounds(name, bench)
    sign = -1.0 if name in SIGNED and rng.random() < 0.5 else 1.0
    inverse = name == "parallel_leakage"
    strongest = low if inverse else high
    reference = {key: sign * strongest, **rest}
    share = 0.5 * bench.rig.noise_K / high if name == "thermometer_quantization" else smallest(name, reference, oracle)
    width = high / low
    least = max(MARGIN * share, 1.0 / width)
    if not least < 1.0:
        return None
    factor = float(np.exp(rng.uniform(np.log(least), 0.0)))
    return weaker(name, reference, factor), share / factor
