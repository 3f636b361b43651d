"""Records of a simulated rig for the referee, and what is hidden in them, by seed.

`draw(seed)` returns a record's columns, those of a held-out record or None, and the truth. Nothing here is taken from
the program: `_referee_rig` has the physics, `_referee_scenes` rigs, films, profiles and logs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks._referee_rig import (
    LIMITING_LOOP,
    NOTHING_OUTSIDE,
    PI_FILM,
    Array,
    Film,
    Rig,
    Run,
    film_outputs,
    sigmoid,
)
from benchmarks._referee_scenes import (
    Columns,
    Log,
    Scene,
    draw_film,
    draw_log,
    draw_rig,
    draw_scene,
    film_ends,
    log_uniform,
    logged,
    meter_reading,
    passes,
    run,
    with_cause,
)

Effects = dict[str, dict[str, float]]

KINDS = ("clean", "one", "two", "outside", "other_film")
COUNTS = (30, 40, 20, 15, 15)
BLOCK = sum(COUNTS)
# an effect that changes no channel by more, in noises rms, cannot be seen
FAINT_RAW = 0.3
# sizes met on real rigs, drawn log-uniformly; SIGNED ones have either sign
SIZES: dict[str, dict[str, tuple[float, float]]] = {
    "actuator_delay": {"delay_s": (0.2, 5.0)},
    "actuator_deadband": {"deadband_A": (0.02, 0.3)},
    "heat_sink_warmup": {"sink_capacity_ratio": (3.0, 30.0), "sink_conductance_ratio_per_s": (0.02, 0.5)},
    "radiative_loss": {"loss_per_K3_s": (2e-11, 5e-10)},  # eps in W/K^4; divided by the capacity when drawn
    "ambient_drift": {"drift_K_per_h": (0.3, 5.0)},
    "sensor_lag": {"tau_s": (0.2, 30.0)},
    "thermometer_quantization": {"step_K": (0.05, 0.5)},
    "film_lag": {"tau_s": (0.2, 10.0)},
    "self_heating": {"theta_K_per_W": (100.0, 1e4)},
    "film_drift": {"drift_K_per_h": (0.1, 3.0)},
    "creep": {"share": (0.02, 0.3), "tau_s": (50.0, 2000.0)},
    "meter_lag": {"tau_s": (0.2, 10.0)},
    "timestamp_skew": {"skew_s": (0.1, 5.0)},
    "series_resistance": {"series_ohm": (0.5, 500.0)},
    "parallel_leakage": {"leakage_ohm": (1e5, 1e9)},
    "meter_range_error": {"threshold_ohm": (1.0, 1.0), "error": (0.002, 0.05)},
}
SIGNED = ("ambient_drift.drift_K_per_h", "film_drift.drift_K_per_h", "timestamp_skew.skew_s", "meter_range_error.error")
# drift over a whole record; a room or a film that goes further is repaired, not recorded
MOST_DRIFT_K = {"ambient_drift": 8.0, "film_drift": 4.0}
# physics says that these are alike in one record, so no record hides two of them
ALIKE = {"film_lag", "meter_lag", "timestamp_skew"}
FIELD = {
    "actuator_delay": "delay",
    "actuator_deadband": "deadband",
    "sensor_lag": "sensor_tau",
    "thermometer_quantization": "sensor_step",
    "film_lag": "film_tau",
    "self_heating": "theta",
    "meter_lag": "meter_tau",
    "timestamp_skew": "skew",
    "series_resistance": "series",
    "parallel_leakage": "leakage",
}
# causes that no catalogue lists, each with the range of its size
OUTSIDE: dict[str, tuple[float, float]] = {
    "holder_mass": (0.1, 0.6),  # a holder that takes up heat from the plate: coupling, as a share of G
    "asymmetric_driver": (0.05, 0.2),  # a bridge that gives less current when it cools, fraction
    "lost_commands": (0.01, 0.04),  # share of commands that never arrive; the current before goes on
    "draught": (0.1, 0.5),  # a fan or a door: conductance larger in some stretches, fraction
    "room_cycle": (0.5, 3.0),  # air conditioning: room goes up and down, K
    "drying_water": (0.05, 0.5),  # water evaporates from the plate until it is gone, W at 25 degC
    "sun_patch": (0.3, 2.0),  # sunlight passes over the plate, W
    "thermometer_pickup": (0.03, 0.4),  # the thermometer reads a part of the current, K/A
    "loosened_thermometer": (0.01, 0.08),  # it comes loose midway and reads towards the room, share
    "film_slip": (0.2, 1.5),  # the sample slips midway, its temperature is another, K
    "resistance_ageing": (0.01, 0.1),  # film resistance grows everywhere, dec/h
    "mains_alias": (2.0, 10.0),  # mains hum, aliased to a slow sine, in noises of the meter
    "range_settling": (0.01, 0.1),  # the meter settles after it changes its range, fraction
    "thermoelectric_emf": (5.0, 40.0),  # contacts at two temperatures, uV/K
}
OTHER_FILMS = ("bell_relays", "wide_late_grains", "effective_medium", "coupled_grains", "few_grains", "limiting_loop")


def hidden(seed: int) -> tuple[str, tuple[str, ...], str, str]:
    """Return the kind of a seed's record, its hidden effects, its outside cause, and its other film ('' if none)."""
    block, place = divmod(seed - 1, BLOCK)
    rng = np.random.default_rng([block, 40_417])
    names = [one for _ in range(6) for one in rng.permutation(list(SIZES))]
    causes = [one for _ in range(2) for one in rng.permutation(list(OUTSIDE))]
    films = [one for _ in range(3) for one in rng.permutation(OTHER_FILMS)]
    contents: list[tuple[str, tuple[str, ...], str, str]] = [("clean", (), "", "")] * COUNTS[0]
    contents += [("one", (str(names[k]),), "", "") for k in range(COUNTS[1])]
    for _ in range(COUNTS[2]):
        pair = rng.choice(list(SIZES), 2, replace=False)
        while set(map(str, pair)) <= ALIKE:
            pair = rng.choice(list(SIZES), 2, replace=False)
        contents.append(("two", tuple(map(str, pair)), "", ""))
    contents += [("outside", (), str(causes[k]), "") for k in range(COUNTS[3])]
    for k in range(COUNTS[4]):
        contents.append(("other_film", (str(names[COUNTS[1] + k]),) if k % 2 else (), "", str(films[k])))
    return contents[int(rng.permutation(BLOCK)[place])]


def draw_sizes(
    rng: np.random.Generator, names: tuple[str, ...], rig: Rig, film: Film, duration: float, noise_K: float
) -> Effects:
    """Draw the parameters of effects within the sizes that real rigs have, where these are possible on this rig."""
    found: Effects = {}
    for name in names:
        size = {key: log_uniform(rng, *limits) for key, limits in SIZES[name].items()}
        for key in size:
            if f"{name}.{key}" in SIGNED and rng.random() < 0.5:
                size[key] *= -1
        if name == "heat_sink_warmup":
            # a sink that passes less than the plate does would freeze or boil
            weakest = max(1.5 * rig.conductance / rig.capacity, 0.02)
            size["sink_conductance_ratio_per_s"] = log_uniform(rng, weakest, min(max(8 * weakest, 0.1), 0.5))
        elif name == "radiative_loss":
            size["loss_per_K3_s"] /= rig.capacity
        elif name == "creep":
            size["tau_s"] = log_uniform(rng, 50, min(2000.0, max(duration / 3, 60.0)))
        elif name in MOST_DRIFT_K:
            # a rate that would carry a long record further is met in short ones only
            low, high = SIZES[name]["drift_K_per_h"]
            rate = log_uniform(rng, low, max(min(high, 3600 * MOST_DRIFT_K[name] / duration), 1.2 * low))
            size["drift_K_per_h"] = math.copysign(rate, size["drift_K_per_h"])
        elif name == "thermometer_quantization":
            size["step_K"] = round(log_uniform(rng, max(0.05, 2 * noise_K), 0.5), 4)
        elif name == "meter_range_error":
            cold = -film_ends(film)[0]
            inner = [e for e in range(2, 8) if cold - 0.85 * film.decades < e < cold - 0.1]
            size["threshold_ohm"] = 10.0 ** int(rng.choice(inner or [round(cold - film.decades / 2)]))
        found[name] = size
    return found


def with_effects(rig: Rig, effects: Effects) -> Rig:
    """Return the rig with effects switched on."""
    for name, size in effects.items():
        values = list(size.values())
        if name == "heat_sink_warmup":
            rig = rig._replace(
                sink_capacity=size["sink_capacity_ratio"] * rig.capacity,
                sink_conductance=size["sink_conductance_ratio_per_s"] * rig.capacity,
            )
        elif name == "radiative_loss":
            rig = rig._replace(radiation=values[0] * rig.capacity)
        elif name == "ambient_drift":
            rig = rig._replace(room_drift=values[0] / 3600)
        elif name == "film_drift":
            rig = rig._replace(film_drift=values[0] / 3600)
        elif name == "creep":
            rig = rig._replace(creep_share=values[0], creep_tau=values[1])
        elif name == "meter_range_error":
            rig = rig._replace(range_threshold=values[0], range_error=values[1])
        else:
            rig = rig._replace(**{FIELD[name]: values[0]})
    return rig


def noises(log: Log, rig: Rig) -> dict[str, float]:
    """Return the noise of each channel, with what rounding adds (a step's standard deviation is step / sqrt 12)."""
    steps = log.step_K**2 + rig.sensor_step**2
    # half of the readings have the noise times its ratio
    uneven = math.sqrt((1 + log.noise_ratio**2) / 2)
    return {"temperature_K": math.sqrt(log.noise_K**2 + steps / 12), "resistance_dec": log.noise_dec * uneven}


def trace(scene: Scene, log: Log, film: Film, full: Rig, without: Rig, done: Run) -> tuple[Array, Array]:
    """Return how an effect or a cause changes both channels (K, decades) of the record, under the same currents."""
    caused = scene.cause != ""
    plain = scene
    if caused:
        plain = scene._replace(outside=np.tile(NOTHING_OUTSIDE, (scene.ticks.size, 1)))
    other = run(plain, without, film, done.current)
    change = meter_reading(scene, log, full, done) - meter_reading(scene, log, without, other, not caused)
    return (done.reading - other.reading)[scene.rows], change[scene.rows]


def base_columns(scene: Scene, film: Film, base: Rig, currents: Array) -> tuple[Array, Array, Array]:
    """Return how parameters of plate, film and first states change temperature and -log R, and each one's prior width.

    Plate parameters by finite differences. The film as play operators of many radii, a polynomial of the temperature,
    other initial memory, shift and stretch of its temperature.
    """
    calm = scene._replace(outside=np.tile(NOTHING_OUTSIDE, (scene.ticks.size, 1)), noise=0 * scene.noise, cause="")
    rows, e = scene.rows, film.envelope
    before = run(calm, base, film, currents)
    path = before.film[rows]

    def output(temperature: Array, of: Film = film, memory: Array = scene.memory) -> Array:
        at = scene.at.copy()
        return film_outputs(temperature, of, memory.copy(), at)

    y = output(path)
    thermal, optical, widths = [], [], []
    shifts = {"seebeck": 1e-3, "resistance": 2e-3, "conductance": 1e-3, "room": 0.05}
    for name, shift in {**shifts, "seebeck_slope": 5e-5, "resistance_slope": 5e-5, "first": 0.05}.items():
        start = scene.start + (shift if name == "first" else 0.0)
        moved = base if name == "first" else base._replace(**{name: getattr(base, name) + shift})
        after = run(calm._replace(start=start), moved, film, currents, False)
        step = (after.reading - before.reading)[rows]
        thermal.append(step / shift)
        optical.append((output(path + step) - y) / shift)
        # slopes of bismuth telluride are known to about this
        widths.append({"seebeck_slope": 1e-3, "resistance_slope": 7e-4}.get(name, np.inf))
    ends = (e[2] + e[3], e[2] - e[3]) if film.kind == LIMITING_LOOP else (e[2], e[4])
    plays = np.array([0.0, e[1], ends[0], e[1], ends[1], *e[5:]])
    none = np.zeros(1, np.int64)
    operator = Film(PI_FILM, np.zeros(1), np.zeros(1), np.ones(1), none, plays, np.array([2.0, 0, 0, 0]), 0, 1.0, 0.0)
    for radius in np.linspace(0.02, 0.85, 14):
        one = operator._replace(first=np.array([radius]))
        low = max(sigmoid(plays[1] * (path[0] - ends[0]), 0) - radius, -1 + radius)
        high = min(sigmoid(plays[1] * (path[0] - ends[1]), 0) + radius, 1 - radius)
        at = np.array([path[0], 0.0, 0.0, 0.0])
        both = [film_outputs(path, one, np.array([w]), at.copy()) for w in (low, high)]
        optical += [both[0], both[1] - both[0]]
    unit = (path - e[5]) / e[6]
    optical += [unit**k for k in range(5)]
    optical += [(output(path + 0.05) - y) / 0.05, (output(path + 0.05 * unit) - y) / 0.05]
    thermal += [np.zeros(path.size)] * (len(optical) - len(thermal))
    widths += [np.inf] * (len(optical) - len(widths))
    return np.array(thermal).T, np.array(optical).T, np.array(widths)


def absorbed(change: tuple[Array, Array], columns: tuple[Array, Array, Array], noise: list[float]) -> list[float]:
    """Return what remains of a trace in each channel (noises rms) when the base model is fitted again, linearized."""
    matrix = np.vstack([columns[0] / noise[0], columns[1] / noise[1], np.diag(1 / columns[2])])
    target = np.concatenate([change[0] / noise[0], change[1] / noise[1], np.zeros(columns[2].size)])
    scale = np.sqrt((matrix**2).mean(axis=0)) + 1e-12
    left = target - matrix / scale @ np.linalg.lstsq(matrix / scale, target, rcond=1e-10)[0]
    n = change[0].size
    return [float(np.sqrt(np.mean(part**2))) for part in (left[:n], left[n : 2 * n])]


def draw(seed: int) -> tuple[Columns, Columns | None, dict[str, Any]]:
    """Return the columns of a seed's record, of a second record of the same rig (or None), and the truth.

    Records whose plate leaves its range, which miss the transition, or hide an effect that cannot be seen are drawn
    again; after ten of these an effect may be invisible, and the truth says so.
    """
    for attempt in range(200):
        found = attempted(seed, attempt)
        if found is not None:
            return found
    raise RuntimeError(f"seed {seed}: no record in 200 attempts; draw_rig, draw_film and draw_plan do not fit together")


def attempted(seed: int, attempt: int) -> tuple[Columns, Columns | None, dict[str, Any]] | None:
    """Draw a record; None if it has to be drawn again."""
    kind, names, cause_name, other_film = hidden(seed)
    rng = np.random.default_rng([seed, attempt])
    plain, film = draw_rig(rng), draw_film(rng, other_film)
    log = draw_log(rng, plain, film, "self_heating" in names)
    if kind == "clean":
        # a log without the currents between its rows is none of the base model's
        log = log._replace(every=1)
    rows = int(log_uniform(rng, 1000, 8000))
    cause = (cause_name, log_uniform(rng, *OUTSIDE[cause_name]) if cause_name else 0.0)
    effects = draw_sizes(rng, names, plain, film, rows * log.period, log.noise_K)
    rig = with_cause(with_effects(plain, effects), *cause)
    slow = rig.delay + rig.sensor_tau
    scene = draw_scene(rng, rig, film, log, rows, cause, slow)
    done = run(scene, rig, film)
    power = rig.theta * float((done.meter_current**2 * 10 ** meter_reading(scene, log, rig, done)).max())
    # a film that is warmer by more is none that anyone would go on measuring
    if not passes(scene, film, done) or power > 8:
        return None
    noise = noises(log, rig)
    raw: dict[str, dict[str, float]] = {}
    refit: dict[str, dict[str, float]] = {}
    columns = base_columns(scene, film, plain, done.current)
    for name in [*effects, *([cause_name] if cause_name else [])]:
        without = with_effects(plain, {one: size for one, size in effects.items() if one != name})
        change = trace(scene, log, film, rig, without, done)
        own = noises(log, without)
        raw[name] = {key: float(np.sqrt(np.mean(part**2))) / own[key] for key, part in zip(own, change, strict=True)}
        refit[name] = dict(zip(own, absorbed((change[0], -change[1]), columns, list(own.values())), strict=True))
    faint = [name for name in raw if max(raw[name].values()) < FAINT_RAW]
    if attempt < 10 and faint:
        return None
    # a cause outside the catalogue has to be seen with the base model fitted again: else its record is a clean one
    if attempt < 40 and cause_name and max(refit[cause_name].values()) < 1:
        return None
    second = None
    if rng.random() < 0.34:
        second = another_day(rng, plain, film, log, effects, cause)
    truth = {
        "kind": kind,
        "effects": effects,
        "invisible": faint,
        "visibility_raw": raw,
        "visibility_refit": refit,
        "notes": {
            "outside": {"name": cause_name, "size": cause[1]} if cause_name else None,
            "film": other_film or "play operators",
            "profile": scene.profile,
            "rig": plain._asdict(),
            "log": log._asdict(),
            "noise": noise,
        },
    }
    return logged(rng, scene, log, rig, done), second, truth


def another_day(
    rng: np.random.Generator, plain: Rig, film: Film, log: Log, effects: Effects, cause: tuple[str, float]
) -> Columns | None:
    """Draw a second record of the rig, with another profile in another room; None if ten miss the transition."""
    for _ in range(10):
        rig = with_cause(with_effects(plain._replace(room=plain.room + rng.normal(0, 1.5)), effects), *cause)
        scene = draw_scene(rng, rig, film, log, int(log_uniform(rng, 800, 3000)), cause, rig.delay + rig.sensor_tau)
        done = run(scene, rig, film)
        if passes(scene, film, done):
            return logged(rng, scene, log, rig, done)
    return None
