"""A heated plate is watched: faults that begin in the middle of a run, and experiments with nothing wrong.

    ./peltier benchmark watch [--seeds N] [--only faults,quiet] [--workers N] [--which WORDS]

--which: only these faults: words of a fault's name, 'with' or 'none', 'heating'.

Faults: an independent plate (`_watched_plant`) behind the emulated instruments, on the virtual clock; each of eleven
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

import contextlib
import io
import itertools
import json
import math
import random
import shutil
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._harness import options
from benchmarks._own_plant import SIMULATED_BENCH, behind_the_instruments, noted_phase
from benchmarks._watched_plant import FAULTS, WatchedPlant, drawn

LIMIT_DEGC, BELOW_K, BY_K, ABOVE_LIMIT_K = 95.0, 10.0, 15.0, 2.0
DEPARTED_K, LEAST_S = 2.0, 10.0
NO_FAULT = ("no_transition",)  # a calibration whose range, within weak currents, does not span the film's transition
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


def broken_run(case: tuple[str, bool, bool, int]) -> dict[str, Any]:
    """One run with a fault: what it ended with, and how hot the plate became."""
    from rig.__main__ import main

    fault, with_model, holding, seed = case
    chance = random.Random(repr(case))
    rig_ = drawn(seed, CAPACITIES[seed % 4], CURRENTS[(seed // 4) % 4])
    room = rig_.ambient_degC
    high = min(80.0, _hottest_degC(rig_) - 5.0)
    low = max(30.0, room + 5.0)
    wanted = chance.uniform(max(low + 5.0, 40.0), high)
    model_s = rig_.seebeck / rig_.capacity
    if with_model:
        more = f'kind = "hold"\nmodel = "model.toml"\ntarget = ["start {wanted:.2f} degC", "hold 900 s"]'
        if not holding:
            points = [f"start {low:.1f} degC", "hold 5 s"]
            for _ in range(6):
                points += [f"ramp to {high:.1f} degC at 1.5 K/s", f"ramp to {low:.1f} degC at 1.5 K/s"]
            more = 'kind = "temperature_profile"\nmodel = "model.toml"\ntarget = ' + json.dumps(points)
    elif holding:
        held_A = _holding_A(rig_, wanted)
        more = f'kind = "current_profile"\ntarget = ["start {held_A:.4f} A", "hold 900 s"]'
    else:
        more = 'kind = "hold"\nlaw = "instrument_pid"\ntarget = ["start 50 degC", "hold 10 s"]'
    begin_s = chance.uniform(3.0, 60.0)

    def breaks(plant: WatchedPlant) -> bool:
        if plant.plate_degC > LIMIT_DEGC - BELOW_K or not phase_s:
            return False
        if holding and abs(plant.plate_degC - (wanted if with_model else _settled(plant))) > 1.5:
            phase_s[0] = plant.time_s
            return False
        return plant.time_s - phase_s[0] > begin_s

    folder = Path(tempfile.mkdtemp(prefix="watch-"))
    (folder / "model.toml").write_text(
        PLATE.format(
            s=model_s * chance.uniform(0.97, 1.03),
            r=rig_.resistance / rig_.capacity * chance.uniform(0.95, 1.05),
            g=rig_.conductance / rig_.capacity * chance.uniform(0.9, 1.1),
            a=room + chance.uniform(-2.0, 2.0),
        )
    )
    path = folder / "config.toml"
    path.write_text(
        CONFIGURATION.format(limit_degC=LIMIT_DEGC, limit_A=rig_.limit_A, experiment=more, low=low, high=high)
    )

    verb = "run" if with_model or holding else "calibrate"
    err = io.StringIO()
    with (
        behind_the_instruments(lambda start_s: WatchedPlant(rig_, seed, start_s, fault or None, breaks)) as plants,
        noted_phase(lambda name: name != "polarity") as phase_s,
        contextlib.redirect_stderr(err),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            status = main([verb, str(path), "--out", str(folder / "run")])
        except SystemExit as ended:
            status = int(ended.code or 0)
    plant = plants[-1] if plants else None
    cause = ""
    document = folder / "run.part" / "run.json"
    if document.is_file():
        cause = json.loads(document.read_text())["stop"]["reason"]
    shutil.rmtree(folder, ignore_errors=True)
    broke = plant is not None and plant.broken_s is not None
    return {
        "case": case,
        "status": status,
        "cause": cause,
        "broke": broke,
        "rose_K": plant.hottest_degC - plant.broken_degC if plant is not None and broke else math.nan,
        "hottest_degC": plant.hottest_degC if plant is not None and broke else math.nan,
        "after_s": plant.time_s - plant.broken_s if plant is not None and plant.broken_s is not None else math.nan,
        "departed_K": plant.departed_K if plant is not None else math.nan,
        "text": err.getvalue()[-300:],
    }


def _settled(plant: WatchedPlant) -> float:
    """Where a plate is that no longer moves: its own temperature, half a minute old."""
    while plant.history and plant.history[0][0] < plant.time_s - 30.0:
        plant.history.popleft()
    return plant.history[0][1] if plant.history and plant.time_s - plant.history[0][0] > 29.0 else math.inf


def _rate(rig_: Any, degC: float, current: float) -> float:
    joule = 0.5 * rig_.resistance * current**2
    return float(rig_.seebeck * current * (degC + 273.15) + joule - rig_.conductance * (degC - rig_.ambient_degC + 5.0))


def _holding_A(rig_: Any, degC: float) -> float:
    """About the current that keeps a temperature."""
    low, high = 0.0, rig_.limit_A
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _rate(rig_, degC, middle) < 0.0 else (low, middle)
    return high


def _hottest_degC(rig_: Any) -> float:
    degC = 30.0
    while degC < 95.0 and _rate(rig_, degC, 0.85 * rig_.limit_A) > 0.2 * rig_.limit_A * 0.03 * 330 / rig_.capacity:
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
    with ProcessPoolExecutor(workers) as pool:
        found = list(pool.map(broken_run, cases, chunksize=4))
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


def main() -> int:
    asked = options(__doc__, only=("faults", "quiet"), seeds=20, quiet_cases=200, first=0, which="")
    good = True
    if "faults" in asked.only:
        good &= faults(range(asked.first, asked.first + asked.seeds), asked.workers, asked.which)
    if "quiet" in asked.only:
        from benchmarks._quiet_runs import quiet

        good &= quiet(asked.quiet_cases, asked.workers)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
