"""Films of known truth, measured over temperature and identified: error and computing time.

    ./peltier benchmark films [--records 40] [--first SEED] [--kind KIND] [--workers 1] [--limit 120] [--json FILE]

Kinds: play (Prandtl-Ishlinskii films), preisach (500 to 2000 relays), grains (20 to 60 steps), moment (M(H), falling or
rising background), other (NdNiO3, V2O3, films that rise, strain, polarization), steep (D about as steep as the loop).
Of each: RMS of measured - model on the record over the least noise (what the true film leaves when it follows the same
thermometer); RMS error from saturation on a profile that no fit has seen, without noise; computing time of `identify`.
A film whose process dies is bad. The numbers of their transitions: `benchmark transition`.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._film_truths import KINDS, case_of

RECORD_ASKED = 1.1  # times the least noise
FOLLOWED = ("play", "preisach", "moment", "other", "steep")  # kinds that a model can follow
Row = dict[str, Any]


def judged(seed: int, kind: str | None, limit_s: float) -> Row:
    """Return the figures of one film. The process dies after so many seconds of computing."""
    import rig

    case = case_of(seed, kind)
    row: Row = {"seed": seed, "kind": case.kind, "words": case.words, "rows": case.outputs.size, "inner": case.inner}
    row |= {"noise": case.noise, "asked": case.asked}
    decades = case.column == "resistance_ohm"
    output, predicted = ("minus_log10_ohm", "ohm") if decades else (case.column, case.column)
    signal.setitimer(signal.ITIMER_PROF, limit_s)  # SIGPROF ends the process, compiled loops included
    try:
        begin = time.process_time()
        found = rig.identify(rig.read_record(case.columns), output=output)
        row["seconds"] = time.process_time() - begin
        fresh = rig.predict(found, case.fresh, initial=case.initial)  # type: ignore[arg-type]
    except Exception as error:
        return row | {"failed": f"{type(error).__name__}: {str(error).splitlines()[0][:150]}"}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    row["model"] = f"{found.document['film']['kind']}, D {found.document['film']['memoryless']}"
    kept = case.off.copy()  # an outlier that the program did not leave out is in its error
    kept[found.document["film"]["outliers"][0]] = 0.0
    row["record"] = found.film.rmse / math.hypot(case.noise, np.sqrt(np.nanmean(kept**2)))  # type: ignore[union-attr]
    wanted, given = case.fresh[case.column], fresh.columns[f"predicted_{predicted}"]
    left = np.log10(given / wanted) if decades else given - wanted
    return row | {"fresh": float(np.sqrt(np.mean(left**2)))}


def outcomes(seeds: list[int], kind: str | None, workers: int, limit_s: float) -> list[Row]:
    """Return the figures of all films. Each worker has a process, which begins anew when it dies."""
    lane = threading.local()

    def one(seed: int) -> Row:
        try:
            if not hasattr(lane, "pool"):
                lane.pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
                lane.pool.submit(judged, 0, "play", 600.0).result()  # loads and compiles
            row: Row = lane.pool.submit(judged, seed, kind, limit_s).result()
        except BrokenProcessPool:
            del lane.pool
            case = case_of(seed, kind)
            row = {"seed": seed, "kind": case.kind, "words": case.words, "failed": f"died, or took over {limit_s:g} s"}
        print(f"{seed} {row['kind']}: {'; '.join(faults(row)) or 'good'}", file=sys.stderr, flush=True)
        return row

    with ThreadPoolExecutor(workers) as lanes:
        return list(lanes.map(one, seeds))


def faults(row: Row) -> list[str]:
    """Return what is bad about one film, in words. An error counts only where a model can follow the film."""
    if "failed" in row:
        return [row["failed"]]
    found = []
    if row["kind"] in FOLLOWED and row["record"] > RECORD_ASKED:
        found.append(f"record {row['record']:.2f} times the least noise")
    if row["kind"] in FOLLOWED and row["inner"] and row["fresh"] > row["asked"]:
        found.append(f"fresh profile {row['fresh']:.2g} (asked {row['asked']:.2g})")
    return found


def report(rows: list[Row]) -> None:
    """Print a line for each kind, the bad cases, and what was found beside what is asked."""
    print(
        "median; worst           record/least noise     fresh/noise        computing, s       us a row      failed bad"
    )
    for kind in [*(one for one in KINDS if any(row["kind"] == one for row in rows)), "all"]:
        some = [row for row in rows if kind in (row["kind"], "all")]
        good = [row for row in some if "failed" not in row]
        line = f"{kind:9}{len(some):5} films   "
        for name, over in (("record", ""), ("fresh", "noise"), ("seconds", ""), ("seconds", "rows")):
            scale = 1e6 if over == "rows" else 1.0
            values = [scale * row[name] / (row[over] if over else 1.0) for row in good] or [math.nan]
            line += f"{np.median(values):7.3g}; {np.max(values):<10.3g}"
        print(f"{line}{len(some) - len(good):6}{sum(bool(faults(row)) for row in some):4}")
    print("\nbad cases")
    for row in rows:
        if bad := faults(row):
            print(f"{row['seed']:5} {row['kind']:9} {'; '.join(bad)}  [{row['words']}; {row.get('model', 'no model')}]")

    good = [row for row in rows if "failed" not in row]
    print()
    for kinds, name in ((FOLLOWED, "all but grains"), (("preisach",), "Preisach films")):
        some = [row for row in good if row["kind"] in kinds]
        within = sum(row["record"] <= RECORD_ASKED for row in some)
        print(f"record within {RECORD_ASKED} times the least noise, {name}: {within} of {len(some)}, asked all")
        some = [row for row in some if row["inner"]]
        within = sum(row["fresh"] <= row["asked"] for row in some)
        print(f"fresh profile within 0.003 dec or 1.5 times the noise, {name}: {within} of {len(some)}, asked all")
    print(f"failed: {len(rows) - len(good)} of {len(rows)}, asked none")


def main() -> int:
    """Judge the films that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="seed of the first film")
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--limit", type=float, default=120.0, help="seconds of computing for a film")
    parser.add_argument("--json", type=Path, help="the figures of each film")
    asked = parser.parse_args()
    seeds = list(range(asked.first, asked.first + asked.records))
    rows = outcomes(seeds, asked.kind, asked.workers, asked.limit)
    report(rows)
    if asked.json:
        asked.json.write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
