"""Experiments with nothing wrong but an effect of the catalogue: none may trip. See `benchmarks/watch.py`."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import random
import shutil
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks._own_plant import SIMULATED_BENCH

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

CONFIGURATION = (
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
    from rig.__main__ import main

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
    effects = f'[[simulation.effects]]\nname = "{name}"\n{lines}' if name else ""
    folder = Path(tempfile.mkdtemp(prefix="quiet-"))
    values = {
        "limit_A": limit_A,
        "seed": seed,
        "room": room,
        "noise": chance.choice((0.002, 0.01, 0.02)),
        "s": seebeck / capacity,
        "r": chance.uniform(1.0, 2.5) / capacity,
        "g": chance.uniform(0.3, 0.5) / capacity,
        "high": chance.uniform(70.0, 80.0) if limit_A > 2.5 else 70.0,
        "effects": effects,
    }
    (folder / "none.toml").write_text("")
    found: dict[str, Any] = {"case": case, "capacity": capacity, "limit_A": limit_A}
    text = ""
    for verb in ("calibrate", "run"):
        model = "cal/MODEL.toml" if verb == "run" else "none.toml"
        path = folder / f"{verb}.toml"
        path.write_text(CONFIGURATION.format(model=model, **values))
        if verb == "run":
            _write_target(folder)
        else:
            (folder / "target.csv").write_text("time_s,target_ohm\n0,1e4\n1,1e4\n")
        err = io.StringIO()
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
            try:
                status = main([verb, str(path), "--out", str(folder / ("cal" if verb == "calibrate" else "run"))])
            except SystemExit as ended:
                status = int(ended.code or 0)
        found[verb] = status
        if status:
            text = err.getvalue()[-400:]
            break
    shutil.rmtree(folder, ignore_errors=True)
    return {**found, "text": text}


def _write_target(folder: Path) -> None:
    """A course in the middle half of the decades that the calibration saw on its way down."""
    import csv
    import math

    with (folder / "cal" / "record.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["phase"] in ("major", "minor")]
    logs = sorted(math.log10(float(row["resistance_ohm"])) for row in rows if row["resistance_ohm"] not in ("", "nan"))
    low, high = logs[len(logs) // 4], logs[3 * len(logs) // 4]
    lines = ["time_s,target_ohm"]
    for k in range(7):
        lines.append(f"{12 * k},{10.0 ** (low + (high - low) * (0.2 if k % 2 else 0.8)):.6g}")
    (folder / "target.csv").write_text("\n".join(lines) + "\n")


def quiet(count: int, workers: int) -> bool:
    """The table of experiments with nothing wrong; whether none tripped."""
    kinds = [(name, sizes) for name, each in SIZES.items() for sizes in each]
    cases = [(k, *kinds[(k * 7) % len(kinds)]) for k in range(count)]
    with ProcessPoolExecutor(workers) as pool:
        found = list(pool.map(quiet_run, cases))
    ends = Counter((r["calibrate"], r.get("run")) for r in found)
    tripped = [r for r in found if 10 in (r["calibrate"], r.get("run")) or 11 in (r["calibrate"], r.get("run"))]
    print(f"experiments with nothing wrong: {len(tripped)} of {count} tripped (asked: 0); exits {dict(ends)}")
    for r in found:
        if r["text"]:
            print(f"      {r['case']} C {r['capacity']:g} J/K, {r['limit_A']:g} A: {json.dumps(r['text'][-300:])}")
    return not tripped
