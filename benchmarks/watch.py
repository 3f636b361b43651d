"""A heated plate is watched: faults that begin in the middle of a run, and experiments with nothing wrong.

    ./peltier benchmark watch [--seeds N] [--only faults,quiet] [--workers N] [--which WORDS]

--which: only these faults: words of a fault's name, 'with' or 'none', 'heating'.

Faults: an independent plate (`tests/truth.py`) behind the emulated instruments, on the virtual clock; each of eleven
faults begins after the polarity pulse, at least 10 K below the limit, with a model and without one, while the plate is
heated and while it is held. Counted is whether the run trips, and how hot the plate became, at the bench's end: above
what it was when the fault began (what a profile asks for meanwhile is in that), and away from what is shown.
A fault that leaves plate and reading where they are (a sensor that stands still in a hold, a fan that nothing needs) is
none until one of them departs: it counts once the plate is `DEPARTED_K` from what is shown, or from where it is wanted.
A sensor that stands still while the plate does may be told only when the output goes off and it does not answer to that
(exit status 11): not caught, but told, counted by itself.

Quiet: simulated experiments (calibrate, then run with what came out) with each effect of the catalogue at several of
the sizes that are met, thermometers that lag by up to 30 s included: none may trip.
"""

from __future__ import annotations

import csv
import itertools
import json
import math
import random
import sys
import tempfile
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._bench import SIMULATED_BENCH, Ended, command
from benchmarks._harness import options, side_by_side
from tests.truth import NOISE_K, Film, Plant, Plate

LIMIT_DEGC, BELOW_K, BY_K, ABOVE_LIMIT_K = 95.0, 10.0, 15.0, 2.0
DEPARTED_K, LEAST_S = 2.0, 10.0
NO_FAULT = ("no_transition",)  # a calibration whose range, within weak currents, does not span the film's transition
STUCK_NOISE_K, IN_AIR_S, FALLS_WITHIN_S, LEFT_CONTACT = 0.005, 5.0, 20.0, 0.3
DEAD_FAN = 0.1  # of the sink's conductance
CAPACITIES, CURRENTS = (10.0, 20.0, 30.0, 60.0), (2.0, 2.5, 3.0, 4.0)

CONFIGURATION = (
    SIMULATED_BENCH
    + """
[limits]
temperature_degC = [5, {limit_degC}]
current_A = {limit_A}
[experiment]
{experiment}
period_s = 0.2
[calibration]
temperature_degC = [{low}, {high}]
rate_K_per_s = 1.5
dwell_s = 4.0
minor_loops = 4
"""
)

PLATE = """
[plate]
kind = "peltier"
seebeck_over_capacity_per_A_s = {s}
resistance_over_capacity_K_per_A2_s = {r}
conductance_over_capacity_per_s = {g}
ambient_degC = {a}
"""


FAULTS = (
    "falls at once",
    "falls within 20 s",
    "30 % contact",
    "sticks exactly",
    "sticks with noise",
    "steps up by 10 K",
    "steps down by 10 K",
    "drifts by -1.5 K/s",
    "drifts by -0.5 K/s",
    "polarity turns",
    "fan dies",
)
FILM = Film(  # enough for an experiment to run
    lambda v: np.tanh([0.2 * v - 12.6]) - 0.1,
    lambda v: np.tanh([0.2 * v - 11.8]) + 0.1,
    np.array([0.7]),
    np.linspace(0.0, 120.0, 1201),
    lambda v: 0.3 * np.tanh(0.03 * v - 1.6) - 4.0,
)


class WatchedPlant(Plant):
    """A rig of usual size, whose fan keeps the sink within some 10 K. fault: one of FAULTS, which begins as soon as
    `breaks`, called with the plant, says so."""

    def __init__(
        self, seed: int, capacity: float, start_s: float, fault: str, breaks: Callable[[WatchedPlant], bool]
    ) -> None:
        uniform = random.Random(seed).uniform
        module = uniform(0.03, 0.06), uniform(1.0, 3.0), uniform(0.3, 0.8)
        sink = {
            "sink_capacity_ratio": uniform(150.0, 600.0) / capacity,
            "sink_conductance_ratio_per_s": uniform(4.0, 12.0) / capacity,
        }
        plate = Plate(*module, capacity, uniform(18.0, 28.0))
        super().__init__(plate, FILM, seed + 1, start_s, {"heat_sink_warmup": sink})
        self.fault, self._breaks = fault, breaks
        self.broken_s: float | None = None
        self.broken_degC = self._stuck_degC = math.nan
        self.hottest_degC = -math.inf  # since it broke
        self.departed_K = 0.0  # largest distance of the plate from what is shown, since it broke
        self.history: deque[tuple[float, float]] = deque()

    def sink_temperature_degC(self) -> float:
        return self.sink_degC

    def begin_step(self) -> None:
        if self.broken_s is not None:
            self.hottest_degC = max(self.hottest_degC, self.degC)
        elif self.fault and self._breaks(self):
            self.broken_s, self.broken_degC = self.time_s, self.degC
            self.polarity = -1.0 if self.fault == "polarity turns" else 1.0
            self.fan = DEAD_FAN if self.fault == "fan dies" else 1.0

    def read_temperature_degC(self) -> float:
        shown, noise = self.degC, NOISE_K
        if self.broken_s is not None:
            if math.isnan(self._stuck_degC):
                self._stuck_degC = shown + self._chance.gauss(0.0, noise)
            shown = self._broken(shown, self.time_s - self.broken_s)
            noise = {"sticks exactly": 0.0, "sticks with noise": STUCK_NOISE_K}.get(self.fault, noise)
            self.departed_K = max(self.departed_K, abs(shown - self.degC))
        self.history.append((self.time_s, self.degC))
        return shown + self._chance.gauss(0.0, noise)

    def _broken(self, shown: float, since_s: float) -> float:
        room, stuck = self.plate.ambient_degC, self._stuck_degC
        return {
            "falls within 20 s": room + max(1.0 - since_s / FALLS_WITHIN_S, 0.0) * (shown - room),
            "30 % contact": room + LEFT_CONTACT * (shown - room),
            "steps up by 10 K": shown + 10.0,
            "steps down by 10 K": shown - 10.0,
            "drifts by -1.5 K/s": shown - 1.5 * since_s,
            "drifts by -0.5 K/s": shown - 0.5 * since_s,
            "falls at once": room + (stuck - room) * math.exp(-since_s / IN_AIR_S),
            "sticks exactly": stuck,
            "sticks with noise": stuck,
        }.get(self.fault, shown)


def broken_run(case: tuple[str, bool, bool, int]) -> dict[str, Any]:
    """One run with a fault: what it ended with, and how hot the plate became."""
    fault, with_model, holding, seed = case
    chance, capacity, limit_A = random.Random(repr(case)), CAPACITIES[seed % 4], CURRENTS[(seed // 4) % 4]
    plate = WatchedPlant(seed, capacity, 0.0, "", lambda _: False).plate
    high = min(80.0, _hottest_degC(plate, limit_A) - 5.0)
    low = max(30.0, plate.ambient_degC + 5.0)
    wanted = chance.uniform(max(low + 5.0, 40.0), high)
    if with_model and holding:
        more = f'kind = "hold"\nmodel = "model.toml"\ntarget = ["start {wanted:.2f} degC", "hold 900 s"]'
    elif with_model:
        points = [f"start {low:.1f} degC", "hold 5 s"]
        points += 6 * [f"ramp to {high:.1f} degC at 1.5 K/s", f"ramp to {low:.1f} degC at 1.5 K/s"]
        more = 'kind = "temperature_profile"\nmodel = "model.toml"\ntarget = ' + json.dumps(points)
    elif holding:
        held_A = _holding_A(plate, wanted, limit_A)
        more = f'kind = "current_profile"\ntarget = ["start {held_A:.4f} A", "hold 900 s"]'
    else:
        more = 'kind = "hold"\nlaw = "instrument_pid"\ntarget = ["start 50 degC", "hold 10 s"]'
    begin_s = chance.uniform(3.0, 60.0)

    def breaks(plant: WatchedPlant) -> bool:
        if plant.degC > LIMIT_DEGC - BELOW_K or not ended.begin_s:
            return False
        if holding and abs(plant.degC - (wanted if with_model else _settled(plant))) > 1.5:
            ended.begin_s[0] = plant.time_s
            return False
        return plant.time_s - ended.begin_s[0] > begin_s

    ended = Ended()
    with tempfile.TemporaryDirectory(prefix="watch-") as name:
        folder = Path(name)
        s, r, g = (x / capacity for x in (plate.seebeck, plate.resistance, plate.conductance))
        model = {"s": s * chance.uniform(0.97, 1.03), "r": r * chance.uniform(0.95, 1.05)}
        model |= {"g": g * chance.uniform(0.9, 1.1), "a": plate.ambient_degC + chance.uniform(-2.0, 2.0)}
        (folder / "model.toml").write_text(PLATE.format(**model))
        path = folder / "config.toml"
        path.write_text(
            CONFIGURATION.format(limit_degC=LIMIT_DEGC, limit_A=limit_A, experiment=more, low=low, high=high)
        )
        words = ["run" if with_model or holding else "calibrate", path, "--out", folder / "run"]
        made = lambda start_s: WatchedPlant(seed, capacity, start_s, fault, breaks)  # noqa: E731
        command(words, made, lambda name: name != "polarity", ended)
        document = folder / "run.part" / "run.json"
        cause = json.loads(document.read_text())["stop"]["reason"] if document.is_file() else ""
    plant = ended.plants[-1]
    broke = plant.broken_s is not None
    return {
        "case": case,
        "status": ended.status,
        "cause": cause,
        "broke": broke,
        "rose_K": plant.hottest_degC - plant.broken_degC,
        "hottest_degC": plant.hottest_degC,
        "after_s": plant.time_s - plant.broken_s if broke else math.nan,
        "departed_K": plant.departed_K,
        "text": ended.said,
    }


def _settled(plant: WatchedPlant) -> float:
    """Where a plate is that no longer moves: its own temperature, half a minute old."""
    while plant.history and plant.history[0][0] < plant.time_s - 30.0:
        plant.history.popleft()
    return plant.history[0][1] if plant.history and plant.time_s - plant.history[0][0] > 29.0 else math.inf


def _rate(plate: Plate, degC: float, current: float) -> float:
    lost = plate.conductance * (degC - plate.ambient_degC + 5.0)
    return plate.pumped_W(degC, current) + plate.joule_W(degC, current) - lost


def _holding_A(plate: Plate, degC: float, limit_A: float) -> float:
    """About the current that keeps a temperature."""
    low, high = 0.0, limit_A
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _rate(plate, degC, middle) < 0.0 else (low, middle)
    return high


def _hottest_degC(plate: Plate, limit_A: float) -> float:
    degC = 30.0
    while degC < 95.0 and _rate(plate, degC, 0.85 * limit_A) > 0.2 * limit_A * 0.03 * 330 / plate.capacity:
        degC += 1.0
    return degC


def counted(result: dict[str, Any]) -> bool:
    """Whether there was anything to be caught: not where the run was nearly over, nor where it failed for another
    reason before anything had departed."""
    if not result["broke"] or (result["status"] == 0 and result["after_s"] < LEAST_S):
        return False
    if result["cause"] in NO_FAULT:
        return False
    return result["status"] != 0 or not math.isfinite(result["departed_K"]) or result["departed_K"] > DEPARTED_K


def caught(result: dict[str, Any]) -> bool:
    return result["status"] == 10 and result["rose_K"] <= BY_K and result["hottest_degC"] <= LIMIT_DEGC + ABOVE_LIMIT_K


def faults(seeds: range, workers: int, which: str) -> bool:
    """The table of faults; whether all were caught."""
    cases = [
        (fault, model, holding, seed)
        for fault, model, holding in itertools.product(FAULTS, (True, False), (False, True))
        for seed in seeds
        if which in f"{fault} {'with' if model else 'none'} {'holding' if holding else 'heating'}"
        if model or fault != "drifts by -0.5 K/s"
    ]
    found = list(side_by_side(broken_run, cases, workers))
    print(f"{'fault':22s} {'model':6s} {'':8s} caught of counted   most above  departed   latest   causes")
    good = True
    for (fault, model, holding), group in itertools.groupby(found, key=lambda r: r["case"][:3]):
        results = list(group)
        some = [r for r in results if counted(r)]
        ok = [r for r in some if caught(r)]
        good &= len(ok) == len(some)
        rose = max((r["rose_K"] for r in some), default=math.nan)
        departed = max((r["departed_K"] for r in some), default=math.nan)
        late = max((r["after_s"] for r in some), default=math.nan)
        causes = Counter(r["cause"] or f"exit {r['status']}" for r in some)
        told = sum(r["status"] == 11 for r in some)
        words = f"{fault:22s} {'with' if model else 'none':6s} {'holding' if holding else 'heating':8s}"
        more = f"   told at the end: {told}" if told else ""
        counts = f"{len(ok):3d} of {len(some):3d} ({len(results)} run)"
        print(f"{words} {counts}  {rose:7.1f} K {departed:7.1f} K {late:7.1f} s   {dict(causes)}{more}")
        for r in some:
            if not caught(r) and r["status"] != 11:
                apart = f"{r['departed_K']:.1f} K from what is shown"
                how = f"rose {r['rose_K']:.1f} K to {r['hottest_degC']:.1f} degC, {apart}"
                print(f"      missed: {r['case']} {how}, {r['text'][-160:]!r}")
    return good


SIZES: dict[str, list[dict[str, float]]] = {
    "actuator_delay": [{"delay_s": d} for d in (0.2, 1.0, 2.5, 5.0)],
    "actuator_deadband": [{"deadband_A": d} for d in (0.02, 0.1, 0.3)],
    "heat_sink_warmup": [
        {"sink_capacity_ratio": c, "sink_conductance_ratio_per_s": g}
        for c, g in itertools.product((3.0, 10.0, 30.0), (0.1, 0.2, 0.5))
    ],
    "radiative_loss": [{"eps_W_per_K4": e} for e in (2e-11, 1e-10, 5e-10)],
    "ambient_drift": [{"drift_K_per_h": d} for d in (-5.0, 0.3, 5.0)],
    "sensor_lag": [{"tau_s": t} for t in (0.2, 0.6, 1.0, 3.0, 10.0, 20.0, 30.0)],
    "thermometer_quantization": [{"step_K": s} for s in (0.05, 0.2, 0.5)],
    "film_lag": [{"tau_s": t} for t in (0.2, 2.0, 10.0)],
    "self_heating": [{"theta_K_per_W": t} for t in (100.0, 1e3, 1e4)],
    "film_drift": [{"drift_K_per_h": d} for d in (-3.0, 0.1, 3.0)],
    "creep": [{"share": s, "tau_s": t} for s, t in ((0.02, 2000.0), (0.1, 300.0), (0.3, 50.0))],
    "meter_lag": [{"tau_s": t} for t in (0.2, 2.0, 10.0)],
    "timestamp_skew": [{"skew_s": s} for s in (0.1, 1.0, 5.0)],
    "series_resistance": [{"series_ohm": r} for r in (0.5, 20.0, 500.0)],
    "parallel_leakage": [{"leakage_ohm": r} for r in (1e5, 1e7, 1e9)],
    "meter_range_error": [{"threshold_ohm": r, "error": e} for r, e in ((1e3, 0.05), (1e4, 0.002))],
    "": [{}],
}

QUIET = (
    SIMULATED_BENCH
    + """
[limits]
temperature_degC = [5, 95]
current_A = {limit_A}
[experiment]
kind = "track_resistance"
target = "target.csv"
model = "{model}"
period_s = 0.2
[calibration]
temperature_degC = [30, {high}]
rate_K_per_s = 1.5
minor_loops = 2
dwell_s = 4.0
[simulation]
seed = {seed}
first_degC = {room}
thermometer_noise_K = {noise}
[simulation.plate]
kind = "peltier"
seebeck_over_capacity_per_A_s = {s}
resistance_over_capacity_K_per_A2_s = {r}
conductance_over_capacity_per_s = {g}
ambient_degC = {room}
[simulation.film]
seed = {seed}
{effects}
"""
)


def quiet_run(case: tuple[int, str, dict[str, float]]) -> dict[str, Any]:
    """Calibrate, then run with what came out: what each ended with."""
    seed, name, sizes = case
    chance = random.Random(repr(case))
    capacity = chance.choice((10.0, 20.0, 30.0, 60.0))
    limit_A = chance.choice((2.5, 3.0, 4.0)) if capacity < 60.0 else 4.0
    seebeck = chance.uniform(0.045, 0.06)
    room = chance.uniform(20.0, 27.0)
    parameters = dict(sizes)
    if "eps_W_per_K4" in parameters:
        parameters = {"loss_per_K3_s": parameters["eps_W_per_K4"] / capacity}
    lines = "".join(f"{key} = {value!r}\n" for key, value in parameters.items())
    values = {
        "limit_A": limit_A,
        "seed": seed,
        "room": room,
        "noise": chance.choice((0.002, 0.01, 0.02)),
        "s": seebeck / capacity,
        "r": chance.uniform(1.0, 2.5) / capacity,
        "g": chance.uniform(0.3, 0.5) / capacity,
        "high": chance.uniform(70.0, 80.0) if limit_A > 2.5 else 70.0,
        "effects": f'[[simulation.effects]]\nname = "{name}"\n{lines}' if name else "",
    }
    found: dict[str, Any] = {"case": case, "capacity": capacity, "limit_A": limit_A, "text": ""}
    with tempfile.TemporaryDirectory(prefix="quiet-") as temporary:
        folder, path = Path(temporary), Path(temporary) / "config.toml"
        (folder / "none.toml").write_text("")
        (folder / "target.csv").write_text("time_s,target_ohm\n0,1e4\n1,1e4\n")
        for verb, model in (("calibrate", "none.toml"), ("run", "calibrate/MODEL.toml")):
            path.write_text(QUIET.format(model=model, **values))
            if verb == "run":
                _write_target(folder)
            ended = command([verb, path, "--out", folder / verb])
            found[verb] = ended.status
            if ended.status:
                found["text"] = ended.said
                break
    return found


def _write_target(folder: Path) -> None:
    """A course in the middle half of the decades that the calibration saw on its way down."""
    with (folder / "calibrate" / "record.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["phase"] in ("major", "minor")]
    logs = sorted(math.log10(float(row["resistance_ohm"])) for row in rows if row["resistance_ohm"] not in ("", "nan"))
    low, high = logs[len(logs) // 4], logs[3 * len(logs) // 4]
    lines = [f"{12 * k},{10.0 ** (low + (high - low) * (0.2 if k % 2 else 0.8)):.6g}" for k in range(7)]
    (folder / "target.csv").write_text("\n".join(["time_s,target_ohm", *lines]) + "\n")


def quiet(count: int, workers: int) -> bool:
    """The table of experiments with nothing wrong; whether none tripped."""
    kinds = [(name, sizes) for name, each in SIZES.items() for sizes in each]
    cases = [(k, *kinds[(k * 7) % len(kinds)]) for k in range(count)]
    found = list(side_by_side(quiet_run, cases, workers))
    ends = Counter((r["calibrate"], r.get("run")) for r in found)
    tripped = [r for r in found if 10 in (r["calibrate"], r.get("run")) or 11 in (r["calibrate"], r.get("run"))]
    print(f"experiments with nothing wrong: {len(tripped)} of {count} tripped (asked: 0); exits {dict(ends)}")
    for r in found:
        if r["text"]:
            print(f"      {r['case']} C {r['capacity']:g} J/K, {r['limit_A']:g} A: {json.dumps(r['text'][-300:])}")
    return not tripped


def main() -> int:
    asked = options(__doc__, only=("faults", "quiet"), seeds=20, quiet_cases=200, first=0, which="")
    good = True
    if "faults" in asked.only:
        good &= faults(range(asked.first, asked.first + asked.seeds), asked.workers, asked.which)
    if "quiet" in asked.only:
        good &= quiet(asked.quiet_cases, asked.workers)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
