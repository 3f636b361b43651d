"""Upper limits: is the true size below them, and how far above what could have been found are they?

    ./peltier benchmark limits [--cases 300] [--first 0] [--results FILE] [--workers N] [--engine dask]

Each case hides one effect at 0.3 to 1 times the size that a test with the true model finds half of the time; the rig,
film and record are drawn by a generator that shares no code with the simulator. The record is diagnosed, and the limit
for the hidden effect is held against its true size. Where the diagnosis names the effect there is no limit to judge.
Strengths are compared: of a leakage and of a heat sink, where less is stronger, the inverses.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from rig.batch import (  # noqa: E402
    Case,
    each_ended,
    opened,
)
from rig.command.batch import add_engine_arguments, engine_choice  # noqa: E402
from tests.sim.diagnosis.score import wilson  # noqa: E402

FROM_BELOW = ("parallel_leakage", "heat_sink_warmup")
Row = dict[str, Any]


def names() -> list[str]:
    """The effects that a limit is asked for: a lattice of readings is seen, and not fitted."""
    from tests.sim.diagnosis.truth.sizes import SIZES

    return [name for name in SIZES if name != "thermometer_quantization"]


def one(seed: int) -> Row:
    """One case, and what its limit says."""
    from sim.diagnosis.diagnose import diagnose
    from tests.sim.diagnosis.cases import case

    of = names()
    effect, factor = of[seed % len(of)], float(np.random.default_rng([11, seed]).uniform(0.3, 1.0))
    row: Row = {"seed": seed, "effect": effect, "factor": factor}
    try:
        truth = case("smallest", seed, effect=effect, factor=factor, any_size=True)
    except RuntimeError as error:
        return row | {"no_bench": str(error)}
    began = time.perf_counter()
    document = diagnose(truth.columns).document()
    row |= {"seconds": time.perf_counter() - began, "named": [e["name"] for e in document["effects"]]}
    hidden = truth.hidden[effect]
    size = abs(hidden["error"] if effect == "meter_range_error" else next(iter(hidden.values())))
    row |= {"true": size, "verdict": document["verdict"]}
    limits = {limit["name"]: limit["limit95"] for limit in document["upper_limits"]}
    if effect in limits:
        limit, below = limits[effect], effect in FROM_BELOW
        row["limit"] = limit
        if limit is not None:
            row["over_true"] = size / limit if below else limit / size
            row["over_half"] = row["over_true"] * factor
    return row


def table(rows: list[Row]) -> None:
    """What was asked, and what was reached."""
    print(f"{'':<28}{'cases':>6}{'named':>7}{'above the truth':>18}{'over half found':>17}{'none given':>12}")
    asked = f"{'asked':<28}{'':>6}{'':>7}{'93 %':>18}{'2':>17}{'10 %':>12}"
    for name in ["", *names()]:
        own = [r for r in rows if "true" in r and (not name or r["effect"] == name)]
        judged = [r for r in own if "limit" in r]
        given = [r for r in judged if r["limit"] is not None]
        if not judged:
            continue
        above = sum(r["limit"] is None or r["over_true"] >= 1.0 for r in judged)
        low, high = wilson(above, len(judged))
        ratio = statistics.median(r["over_half"] for r in given) if given else float("nan")
        none = 1.0 - len(given) / len(judged)
        share = f"{100.0 * above / len(judged):.1f} [{100.0 * low:.0f}, {100.0 * high:.0f}]"
        named = sum(r["effect"] in r["named"] for r in own)
        print(f"{name or 'all':<28}{len(own):>6}{named:>7}{share:>18}{ratio:>17.2f}{100.0 * none:>10.1f} %")
        if not name:
            print(asked)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    add_engine_arguments(parser)
    parser.add_argument("--results", type=Path, help="a line of JSON for each case")
    options = parser.parse_args()
    rows: list[Row] = []
    cases = [Case(k, one, (options.first + k,)) for k in range(options.cases)]
    with opened(engine_choice(options), options.cases) as engine:
        for count, ended in enumerate(each_ended(cases, engine), 1):
            row = ended.value or {"seed": options.first + ended.number, "error": ended.fault}
            rows.append(row)
            print(f"{count}/{options.cases} {json.dumps(row)}", file=sys.stderr, flush=True)
            if options.results is not None:
                with options.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
    if skipped := sum("no_bench" in r for r in rows):
        print(f"{skipped} cases: no bench shows the effect so small within the sizes that one meets")
    table(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
