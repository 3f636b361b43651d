"""The program's own runs: is an effect hidden in the simulated rig named, alone, with nothing left?

    ./peltier benchmark own_runs [--seeds N] [--first N] [--effects film_lag,...] [--ways simulate,run] [--workers N]

Each case is the demo (configs/demo.toml, without its heat sink) with one effect: as `simulate --effect`, or in
[simulation] of a `run`, whose record is then diagnosed. Film, noise and the effect's size are drawn: of every two films
one is a Preisach film, as the demo's, and the other one of the model's class. Counted is the verdict "explained" with
just that effect.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import os
import random
import shutil
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import tomli_w  # noqa: E402

ASKED = 57.0 / 60.0
SIZES: dict[str, dict[str, tuple[float, float]]] = {  # as one meets them, and as a run of three minutes can show
    "actuator_delay": {"delay_s": (0.3, 1.5)},
    "heat_sink_warmup": {"sink_capacity_ratio": (5.0, 20.0), "sink_conductance_ratio_per_s": (0.1, 0.5)},
    "sensor_lag": {"tau_s": (0.5, 3.0)},
    "film_lag": {"tau_s": (0.5, 4.0)},
    "self_heating": {"theta_K_per_W": (1000.0, 1e4)},
    "film_drift": {"drift_K_per_h": (1.5, 3.0)},
}
WAYS = ("simulate", "run")


@dataclass(frozen=True)
class Case:
    """One effect in one way; the seed draws all else."""

    effect: str
    way: str
    seed: int


def configuration(case: Case) -> tuple[dict[str, Any], dict[str, float]]:
    """The demo's, with film, noise and seed of its own and no effect; and the effect's size."""
    chance = random.Random(f"{case.effect} {case.way} {case.seed}")
    raw = tomllib.loads((ROOT / "configs" / "demo.toml").read_text())
    raw["experiment"]["compare"] = []
    raw["limits"]["meter_current_A"] = 1e-4  # at 1 mA a film of 3 kohm is warmed by kelvins: no lab does that
    simulation = raw["simulation"]
    del simulation["heat_sink_warmup"]
    simulation["seed"] = chance.randrange(10**6)
    simulation["film"] = {"kind": "preisach", "decades": chance.uniform(1.6, 2.2), "seed": chance.randrange(10**6)}
    if case.seed % 2:
        simulation["film"] = {"kind": "model", "model": "film.toml"}
    size = {name: _drawn(chance, *span) for name, span in SIZES[case.effect].items()}
    return raw, size


def _drawn(chance: random.Random, low: float, high: float) -> float:
    return math.exp(chance.uniform(math.log(low), math.log(high)))


def film_text(case: Case) -> str:
    """A film of the model's class with a dozen operators, which is 1.6 to 2.2 decades deep as the other kind is."""
    chance = random.Random(f"film {case.effect} {case.way} {case.seed}")
    radii = sorted(chance.uniform(0.05, 0.9) for _ in range(12))
    weights = [chance.uniform(0.3, 1.0) * math.exp(-2.0 * r) for r in radii]
    depth = chance.uniform(0.7, 0.95) / sum(weights)
    middle, width, steep = chance.uniform(59.0, 63.0), chance.uniform(3.0, 6.0), chance.uniform(0.16, 0.24)
    table = {
        "film": {
            "kind": "extended_generalized_pi",
            "radii": radii,
            "weights": [depth * w for w in weights],
            "rising": {"function": "tanh", "a": steep, "b": -steep * (middle + 0.5 * width)},
            "falling": {"function": "tanh", "a": steep, "b": -steep * (middle - 0.5 * width)},
            "memoryless": {"function": "tanh", "amplitude": 0.35, "a": 0.03, "b": -1.65, "offset": -4.05},
        }
    }
    return tomli_w.dumps(table)


def one(case: Case) -> dict[str, Any]:
    """Recorded and diagnosed; what came out, or why it ended."""
    began = time.perf_counter()
    folder = Path(tempfile.mkdtemp(prefix="own-runs-"))
    raw, size = configuration(case)
    (folder / "film.toml").write_text(film_text(case))
    path, record = folder / "config.toml", folder / "record.csv"
    text = f"{case.effect}:" + ",".join(f"{name}={value:.6g}" for name, value in size.items())
    row: dict[str, Any] = {"effect": case.effect, "way": case.way, "seed": case.seed, "hidden": text}
    if case.way == "run":
        raw["simulation"]["effects"] = [{"name": case.effect, **size}]
        words = ["run", str(path), "--out", str(folder / "run")]
        record = folder / "run" / "record.csv"
    else:
        words = ["simulate", str(path), "--effect", text, "--out", str(record)]
    path.write_text(tomli_w.dumps(raw))
    status, said = _command(words)
    row["ended"] = said if status else ""
    if record.is_file():
        status, said = _command(["diagnose", str(record), "--json", str(folder / "diagnosis.json")])
        if status:
            row["ended"] = said
        else:
            document = json.loads((folder / "diagnosis.json").read_text())
            row |= {key: document[key] for key in ("verdict", "unexplained", "channels")}
            row["named"] = {e["name"]: _values(e["parameters"]) for e in document["effects"]}
    row["right"] = row.get("verdict") == "explained" and list(row["named"]) == [case.effect]
    row["seconds"] = time.perf_counter() - began
    shutil.rmtree(folder, ignore_errors=True)
    return row


def _values(parameters: dict[str, Any]) -> dict[str, float]:
    return {name: found["value"] for name, found in parameters.items()}


def _command(words: list[str]) -> tuple[int, str]:
    """Exit status, and the end of what it said on stderr."""
    from rig.__main__ import main

    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        status = main(words)
    return status, err.getvalue()[-200:].strip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--effects", default=",".join(SIZES))
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    cases = [Case(e, way, s) for s in seeds for e in options.effects.split(",") for way in options.ways.split(",")]
    right = 0
    with ProcessPoolExecutor(options.workers) as pool:
        for row in pool.map(one, cases):
            right += row["right"]
            mark = "right" if row["right"] else "WRONG"
            print(
                f"{mark} {row['way']:8s} {row['seed']:3d} {row['hidden']}: {row.get('verdict', 'no diagnosis')}, ",
                end="",
            )
            print(f"{row.get('named', {})} {row['seconds']:.0f} s {row['ended']}", flush=True)
            if not row["right"] and "unexplained" in row:
                print(f"      left {row['unexplained']}; {_channels(row['channels'])}", flush=True)
    print(f"explained with just that effect: {right} of {len(cases)}, asked {ASKED:.0%}")
    return 0 if right >= ASKED * len(cases) else 1


def _channels(channels: dict[str, Any]) -> str:
    return ", ".join(
        f"{name} {c['rmse_base']:.3g} -> {c['rmse_extended']:.3g}, noise {c['noise']:.3g}"
        for name, c in channels.items()
        if c is not None
    )


if __name__ == "__main__":
    sys.exit(main())
