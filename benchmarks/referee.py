"""Records of an independent referee, diagnosed: is what is hidden named, alone, and do the intervals hold its size?

    ./peltier benchmark referee [--first 1] [--records 120] [--kinds clean,one,two,outside,other_film]
                                [--workers 2] [--results FILE] [--lines] [--json FILE]

A seed is a record of a simulation that shares no line with the program (`_referee_records`). Of 120 seeds that follow
on one another 30 are clean, 40 hide one effect, 20 two, 15 a cause that no catalogue lists (outside), 15 have a film of
another kind, about half of these with an effect. About a third come with a second record, held out.

Right: clean, the verdict "clean"; one, two and other_film, exactly the hidden names (one counts, too, where the hidden
one is in its `indistinguishable_from`; one too faint to see may be missing, and one that plate or film absorb, if a
warning says so); outside, no name. A diagnosis that fails is wrong. Seconds are of computing, on one thread;
`./peltier precompile` first, or the first record pays for it.

Each finished record is a line of --results; begun again with the same file, the benchmark goes on. The lines are those
of the program that wrote them: a changed program takes another file.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from itertools import permutations
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from benchmarks._harness import kept, options, side_by_side  # noqa: E402
from benchmarks._referee_records import FAINT_RAW, KINDS, draw, hidden  # noqa: E402

Row = dict[str, Any]


def judged(seed: int) -> Row:
    """Draw the record of a seed, diagnose it and return what is hidden, what was said and whether that is right."""
    from rig.analysis.diagnosed import diagnosed
    from rig.core.faults import Faults
    from rig.records.record import Record

    columns, held_out, truth = draw(seed)
    name = f"{seed:04d}"
    outside = truth["notes"]["outside"]
    row: Row = {"seed": seed, "kind": truth["kind"], "effects": truth["effects"], "invisible": truth["invisible"]}
    row["hidden"] = list(truth["effects"]) or ([outside["name"]] if outside else [])
    row["weak"] = [one for one in truth["effects"] if max(truth["visibility_refit"][one].values()) < FAINT_RAW]
    row |= {"verdict": "failed", "named": [], "right": False, "sizes": []}
    holdout = [] if held_out is None else [Record(held_out, f"{name}_holdout")]
    begin = time.process_time()
    try:
        document = diagnosed([Record(columns, name)], None, holdout)[0].document()
    except Faults as refused:
        row["failed"] = str(refused)
    except Exception as error:  # the other records are judged all the same
        row["failed"] = f"{type(error).__name__}: {error}"
    else:
        row |= verdict_on(truth["kind"], truth["effects"], truth["invisible"], document)
    return row | {"seconds": time.process_time() - begin}


def verdict_on(kind: str, effects: dict[str, dict[str, float]], invisible: list[str], document: Row) -> Row:
    """Return what a diagnosis says, whether it is right, and which of its intervals hold the truth (None: not given).

    proxies: hidden effects that another name stands for, which the record cannot tell from them.
    """
    found = document["effects"]
    named = [one["name"] for one in found]
    right, proxies = not found, {}
    if kind == "clean":
        right = document["verdict"] == "clean" and not found
    elif effects:
        order = matched(found, list(effects), [*invisible, *absorbed(document, effects)])
        right = order is not None
        proxies = {one: name for one, name in zip(order or (), named, strict=False) if one != name}
    sizes = []
    for one in found:
        for parameter, value in effects.get(one["name"], {}).items():
            interval = ((one.get("parameters") or {}).get(parameter) or {}).get("ci95")
            held = bool(interval[0] <= value <= interval[1]) if interval and None not in interval else None
            sizes.append([one["name"], parameter, held])
    return {"verdict": document["verdict"], "named": named, "right": right, "proxies": proxies, "sizes": sizes}


def absorbed(document: Row, effects: dict[str, dict[str, float]]) -> list[str]:
    """Return the hidden effects of which the diagnosis says that one of this size would not show."""
    told = []
    for warning in document["warnings"]:
        name, _, said = warning["text"].partition(" ")
        if not warning["code"].startswith("absorbed_by") or name not in effects:
            continue
        size = re.match(r"with (\w+) (above|below) ([\d.,e+-]+) ", said)
        if size is None or (effects[name][size[1]] > float(size[3].replace(",", ""))) == (size[2] == "above"):
            told.append(name)
    return told


def matched(found: Sequence[Row], effects: Sequence[str], invisible: Sequence[str]) -> tuple[str, ...] | None:
    """Return which hidden effect each found one stands for; None if a name is wrong, or a visible effect missing."""
    for order in permutations(effects, len(found)):
        fits = all(
            hidden_one == one["name"] or hidden_one in (one.get("indistinguishable_from") or [])
            for one, hidden_one in zip(found, order, strict=True)
        )
        if fits and set(effects) - set(order) <= set(invisible):
            return order
    return None


def finished(path: Path) -> dict[int, Row]:
    """Read the rows of a results file by seed. A line that was cut off when the benchmark ended is done again."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        text = text[: text.rfind("\n") + 1]
        path.write_text(text, encoding="utf-8")
    return {row["seed"]: row for row in map(json.loads, text.splitlines())}


def line(row: Row) -> str:
    """Say in a line what was hidden and what was found."""
    told = f"{row['seed']:04d} {'right' if row['right'] else 'WRONG'} {row['kind']:10} "
    told += f"hidden {'+'.join(row['hidden']) or '-'}; {row['verdict']}: {'+'.join(row['named']) or '-'}"
    notes = [f"{name} stands for {one}" for one, name in row.get("proxies", {}).items()]
    notes += [f"{one} is weak once the base model is fitted again" for one in row["weak"]]
    notes += [f"the interval of {name}.{parameter} misses" for name, parameter, held in row["sizes"] if held is False]
    notes += [row["failed"]] if "failed" in row else []
    return "; ".join([told, *notes]) + f" ({row['seconds']:.0f} s)"


def summary(rows: Sequence[Row]) -> Row:
    """Return the figures of the table."""
    clean = [row for row in rows if row["kind"] == "clean"]
    intervals: dict[str, list[bool | None]] = {}
    for name, parameter, held in (size for row in rows for size in row["sizes"]):
        intervals.setdefault(f"{name}.{parameter}", []).append(held)
    median, late = np.percentile([row["seconds"] for row in rows], [50, 95])
    return {
        "right": {kind: [sum(row["right"] for row in of), len(of)] for kind, of in by_kind(rows).items()},
        "names_on_clean": [name for row in clean for name in row["named"]],
        "ci95": {of: [held.count(True), held.count(False), held.count(None)] for of, held in intervals.items()},
        "seconds": {"median": median, "percentile_95": late, "longest": max(row["seconds"] for row in rows)},
        "failed": [row["seed"] for row in rows if "failed" in row],
    }


def by_kind(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Sort the rows by kind, and those with hidden effects by whether fitting the base model again absorbs one."""
    found = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}
    effects = [row for row in rows if row["effects"]]
    found["an effect weak once refitted"] = [row for row in effects if row["weak"]]
    found["all effects strong"] = [row for row in effects if not row["weak"]]
    return {kind: of for kind, of in found.items() if of}


def table(rows: Sequence[Row]) -> None:
    """Print how many are right by kind, names on clean records, intervals, computing time."""
    figures = summary(rows)
    for kind, (right, of) in figures["right"].items():
        print(f"{kind:32}{right:4} of {of:3} right")
    names = figures["names_on_clean"]
    print(f"names on clean records: {len(names)}{': ' if names else ''}{', '.join(names)}")
    held, missed, silent = np.sum([[0, 0, 0], *figures["ci95"].values()], axis=0)
    print(f"ci95 that hold the truth: {held} of {held + missed}; not given {silent}")
    for of, (held, missed, silent) in figures["ci95"].items():
        print(f"  {of:44}{held:4} of {held + missed:3}" + (f"; not given {silent}" if silent else ""))
    seconds = figures["seconds"]
    print(
        f"computing: median {seconds['median']:.1f} s, 95th percentile {seconds['percentile_95']:.1f} s, "
        f"longest {seconds['longest']:.1f} s"
    )
    for row in rows:
        if "failed" in row:
            print(f"failed: {line(row)}")


def main() -> int:
    """Judge the records that were asked for."""
    asked = options(__doc__, first=1, records=120, kinds=tuple(KINDS), results="", lines=False)
    seeds = [seed for seed in range(asked.first, asked.first + asked.records) if hidden(seed)[0] in asked.kinds]
    if not seeds:
        print("no record of these kinds among these seeds: ask for more --records", file=sys.stderr)
        return 2
    done = finished(Path(asked.results)) if asked.results else {}
    todo = [seed for seed in seeds if seed not in done]
    try:
        for row in side_by_side(judged, todo, asked.workers):
            done[row["seed"]] = row
            if asked.results:
                with Path(asked.results).open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
            if asked.lines:
                print(line(row), flush=True)
    except BrokenProcessPool:
        print("a worker died (out of memory?): with --results FILE a new begin goes on from there", file=sys.stderr)
        return 1
    rows = [done[seed] for seed in seeds]
    table(rows)
    kept(asked.json, {"summary": summary(rows), "records": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
