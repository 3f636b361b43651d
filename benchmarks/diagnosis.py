"""Blind cases: what is hidden in a record is found, alone, and nothing else is blamed. The table of what is asked.

    ./peltier benchmark diagnosis [--kinds one,two,...] [--seeds 20] [--first 0] [--results FILE]
                                  [--workers N] [--engine dask [--address tcp://...]]

Every case is drawn from its seed by a generator that shares no code with the simulator. Each finished case is a line of
the results file; started again, the benchmark goes on where it was interrupted, and prints the table of all lines that
belong to what was asked for. `--table` only prints. `--seeds` is the number of seeds for each single effect; the other
kinds have as many cases as the table asks for at 20, and in proportion. `--first` begins with another seed: cases that
nobody has looked at.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rig.batch import Case, EngineChoice, each_ended, opened  # noqa: E402  # noqa: E402
from rig.command.batch import add_engine_arguments, engine_choice  # noqa: E402
from tests.sim.diagnosis.score import Row, confusion, coverage, wilson  # noqa: E402

Job = dict[str, Any]
COUNTS = {  # cases at 20 seeds
    "two": 160,
    "three": 100,
    "clean": 300,
    "other_film": 100,
    "other_film_effect": 100,
    "further_film": 80,
    "domains": 160,
    "outside": 120,
    "indistinguishable": 60,
    "disturbed": 100,
    "negative": 80,
    "real_noise": 300,
    "coloured_noise": 60,
}
FACTORS = (1.0, 1.5)
UNLIKE_OF = ("one", "clean", "other_film")
KINDS = ("one", *COUNTS, "smallest", "long", "unlike")


def jobs(kinds: Iterable[str], seeds: int, first: int = 0) -> list[Job]:
    """What there is to do: kind, seed, choice; kinds in turn, so that an interrupted table shows all of them."""
    from tests.sim.diagnosis.truth.manner import UNLIKE
    from tests.sim.diagnosis.truth.plans import LIMITED
    from tests.sim.diagnosis.truth.sizes import NAMES

    of: list[list[Job]] = []
    for kind in kinds:
        if kind == "one":
            part = [{"kind": kind, "seed": s, "choice": {"effect": name}} for s in range(seeds) for name in NAMES]
        elif kind == "smallest":
            choices = [{"effect": name, "factor": factor} for name in LIMITED for factor in FACTORS]
            part = [{"kind": kind, "seed": s, "choice": choice} for s in range(seeds) for choice in choices]
        elif kind == "unlike":
            choices = [{"manner": manner, "of": of} for of in UNLIKE_OF for manner in UNLIKE]
            part = [
                {"kind": kind, "seed": s, "choice": choice} for s in range(max(1, seeds // 2)) for choice in choices
            ]
        elif kind == "long":
            part = [{"kind": "one", "seed": s, "choice": {"rows": 50_000}} for s in range(max(1, seeds // 4))]
        else:
            count = max(1, round(COUNTS[kind] * seeds / 20))
            part = [{"kind": kind, "seed": s, "choice": {}} for s in range(count)]
        of.append([{**job, "seed": first + job["seed"]} for job in part])
    spread = [((place + 0.5) / len(part), job) for part in of for place, job in enumerate(part)]
    return [job for _, job in sorted(spread, key=lambda pair: pair[0])]


def key_of(job: Job) -> str:
    """A job's name in the results."""
    return json.dumps([job["kind"], job["seed"], job["choice"]], sort_keys=True)


def one(job: Job) -> Row:
    """Make the case, diagnose it, score it. Every fourth case comes with a record of another profile."""
    from rig.analysis.diagnosed import Asked, diagnosed
    from rig.records.record import Record
    from tests.sim.diagnosis.cases import case
    from tests.sim.diagnosis.score import score

    truth = case(job["kind"], job["seed"], **job["choice"])
    held = truth.seed % 4 == 0 and truth.kind != "unlike"  # major loops alone do not tell of the minor ones elsewhere
    holdout = [Record(truth.holdout, "holdout")] if held and truth.holdout is not None else []
    began = time.perf_counter()
    document = diagnosed([Record(truth.columns, "case")], Asked(**truth.options), holdout)[0].document()
    took = time.perf_counter() - began
    after = None
    if truth.follow_up is not None:
        after = diagnosed([Record(truth.follow_up, "follow-up")])[0].document()
    row = score(truth, document, after)
    row |= {
        "key": key_of(job),
        "choice": job["choice"],
        "rows": int(truth.columns["time_s"].size),
        "seconds": took,
        "with_holdout": bool(holdout),
        "parameters": truth.hidden,
        "noise": truth.noise,
        "details": truth.details,
        "findings": document["effects"],
        "film": [truth.film, document["film"]],
        "left": document["unexplained"],
    }
    return row


def read(results: Path, wanted: set[str]) -> dict[str, Row]:
    """The finished lines among the wanted ones; a line cut off by an interruption is none."""
    done: dict[str, Row] = {}
    if results.is_file():
        for line in results.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
            except json.JSONDecodeError:
                continue
            if row["key"] in wanted and "error" not in row:
                done[row["key"]] = row
    return done


def run(todo: list[Job], results: Path, choice: EngineChoice) -> None:
    """Do the jobs, a line for each as it is finished."""
    began = time.perf_counter()
    if results.is_file() and results.stat().st_size and not results.read_bytes().endswith(b"\n"):
        with results.open("a", encoding="utf-8") as file:
            file.write("\n")
    cases = [Case(k, one, (job,)) for k, job in enumerate(todo)]
    with opened(choice, len(todo)) as engine, results.open("a", encoding="utf-8") as file:
        for count, ended in enumerate(each_ended(cases, engine), 1):
            job = todo[ended.number]
            row = ended.value or {
                "key": key_of(job),
                "kind": job["kind"],
                "choice": job["choice"],
                "error": ended.fault,
            }
            file.write(json.dumps(row, default=float) + "\n")
            file.flush()
            said = row.get("error") or f"{row['hidden']} -> {row['named'] or row['verdict']}"
            good = "ok " if row.get("ok") else "NOT"
            print(
                f"{count}/{len(todo)} {time.perf_counter() - began:6.0f} s {good} {row['key']} {said}", file=sys.stderr
            )


def rate(what: str, rows: list[Row], good: Callable[[Row], Any], asked: str) -> None:
    """A line of the table."""
    if not rows:
        return
    hits = sum(bool(good(row)) for row in rows)
    low, high = wilson(hits, len(rows))
    share = f"{100 * hits / len(rows):5.1f} %"
    print(f"{what:<66}{hits:>5} of {len(rows):<5}{share:>9} [{100 * low:5.1f}, {100 * high:5.1f}]   {asked}")


def table(rows: list[Row]) -> None:
    """What is asked, and what was reached."""
    of = {kind: [row for row in rows if row["kind"] == kind and row["rows"] < 20_000] for kind in KINDS}
    print(f"\n{'':<66}{'':>14}{'rate':>9} [95 % interval]  asked")
    rate("one effect: the cause first and nothing else", of["one"], lambda r: r["exactly"], "99 %")
    rate("one effect: the cause first", of["one"], lambda r: r["first"], "")
    rate("two effects: both found", of["two"], lambda r: r["found"], "99 %")
    rate("two effects: exactly these two", of["two"], lambda r: r["exactly"], "95 %")
    rate("three effects: exactly these three", of["three"], lambda r: r["exactly"], "85 %")
    rate("no effect: clean", of["clean"], lambda r: r["clean"], "99 %")
    others = of["other_film"] + of["other_film_effect"]
    rate("film outside the class: no innocent instrument blamed", others, lambda r: not r["instruments_blamed"], "98 %")
    rate("film outside the class: the effect found", of["other_film_effect"], lambda r: r["found"], "95 %")
    further, hidden = of["further_film"], [row for row in of["further_film"] if row["hidden"]]
    rate("film of a further kind: no innocent instrument blamed", further, lambda r: not r["instruments_blamed"], "")
    rate("film of a further kind: the effect found", hidden, lambda r: r["found"], "")
    of_domains = [row for row in of["domains"] if row["hidden"]]
    rate("film that switches in steps: the effect, and nothing else", of_domains, lambda r: r["exactly"], "")
    bare = [row for row in of["domains"] if not row["hidden"]]
    rate("film that switches in steps, no effect: clean", bare, lambda r: r["clean"], "")
    rate("outside the catalogue: unexplained, and no name", of["outside"], lambda r: r["ok"], "95 %")
    for fault in sorted({row["details"]["fault"] for row in of["outside"]}):
        rate(f"    {fault}", [r for r in of["outside"] if r["details"]["fault"] == fault], lambda r: r["ok"], "")
    rate("not to be told apart: named as a set", of["indistinguishable"], lambda r: r["set_named"], "95 %")
    rate("not to be told apart: the next experiment decides", of["indistinguishable"], lambda r: r["decided"], "95 %")
    rate("outliers, gaps, missing rows: the same answer", of["disturbed"], lambda r: r["ok"], "97 %")
    for factor in FACTORS:
        chosen = [row for row in of["smallest"] if row["choice"]["factor"] == factor]
        what = f"{factor:g} times the smallest of the likelihood-ratio test: found"
        rate(what, chosen, lambda r: r["ok"], "50 % at 1.5")
        for effect in sorted({row["choice"]["effect"] for row in chosen}):
            rate(f"    {effect}", [r for r in chosen if r["choice"]["effect"] == effect], lambda r: r["ok"], "")
    for what in UNLIKE_OF:
        chosen = [row for row in of["unlike"] if row["details"]["of"] == what]
        rate(f"taken in another manner, {what}: these names and no other", chosen, lambda r: r["ok"], "")
        for manner in sorted({row["details"]["manner"] for row in chosen}):
            rate(f"    {manner}", [r for r in chosen if r["details"]["manner"] == manner], lambda r: r["ok"], "")
    real = [r for r in of["real_noise"] if not r["hidden"]]
    rate("noise as instruments have it, no effect: no name", real, lambda r: r["ok"], "98 %")
    rate("    and nothing left", real, lambda r: r["ok"] and not r["unexplained"], "")
    shaped = [r for r in of["coloured_noise"] if r["hidden"]]
    rate("noise of another colour: the effect, and nothing else", shaped, lambda r: r["exactly"], "")
    shaped = [r for r in of["coloured_noise"] if not r["hidden"]]
    rate("noise of another colour, no effect: clean", shaped, lambda r: r["clean"], "")
    rate("negative controls: no cause named with confidence", of["negative"], lambda r: r["ok"], "all")
    for control in sorted({row["details"]["control"] for row in of["negative"]}):
        rate(f"    {control}", [r for r in of["negative"] if r["details"]["control"] == control], lambda r: r["ok"], "")
    more_tables(rows, of)


def more_tables(rows: list[Row], of: dict[str, list[Row]]) -> None:
    """Intervals, what remains, time, single effects, who is taken for whom."""
    judged = of["one"] + of["two"] + of["three"]
    counted = coverage(judged)
    pairs = [hit for hits, count in counted.values() for hit in [True] * hits + [False] * (count - hits)]
    rate("true parameters inside their 95 % interval", [{"in": hit} for hit in pairs], lambda r: r["in"], "92 to 98 %")
    for name, (hits, count) in sorted(counted.items()):
        rate(f"    {name}", [{"in": k < hits} for k in range(count)], lambda r: r["in"], "")
    left = [row["remains"] for row in judged if row["with_holdout"] and row["remains"]]
    if left:
        nine = sorted(left)[min(len(left) - 1, int(0.9 * len(left)))]
        print(f"{'what remains over the noise, another profile: 90th percentile':<66}{nine:>14.3f}{'':>28}1.10")
    for name, chosen, asked in (
        ("6,000 rows", [r for r in rows if r["rows"] < 20_000], "20 s"),
        ("50,000 rows", [r for r in rows if r["rows"] >= 20_000], "120 s"),
    ):
        if chosen:
            median = statistics.median(row["seconds"] for row in chosen)
            print(f"{f'one diagnosis, {name}: median (each worker one thread)':<66}{median:>12.1f} s{'':>28}{asked}")
    print("\nsingle effects: the cause first and nothing else")
    for effect in sorted({row["hidden"][0] for row in of["one"]}):
        rate(f"    {effect}", [r for r in of["one"] if r["hidden"] == [effect]], lambda r: r["exactly"], "")
    print("\nhidden -> first named")
    for truth, said in sorted(confusion(rows).items()):
        parts = sorted(said.items(), key=lambda pair: -pair[1])
        print(f"    {truth:<28}" + ", ".join(f"{name} {count}" for name, count in parts))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", default=",".join(KINDS), help=f"of {', '.join(KINDS)}")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--results", type=Path, default=Path("diagnosis_results.jsonl"))
    add_engine_arguments(parser)
    parser.add_argument("--table", action="store_true", help="only print the table of what is there")
    options = parser.parse_args()
    kinds = options.kinds.split(",")
    if unknown := set(kinds) - set(KINDS):
        parser.error(f"unknown kinds {', '.join(sorted(unknown))}: of {', '.join(KINDS)}")
    asked = jobs(kinds, options.seeds, options.first)
    done = read(options.results, {key_of(job) for job in asked})
    todo = [job for job in asked if key_of(job) not in done]
    if todo and not options.table:
        run(todo, options.results, engine_choice(options))
        done = read(options.results, {key_of(job) for job in asked})
    table([done[key_of(job)] for job in asked if key_of(job) in done])
    missing = len(asked) - len(done)
    if missing:
        print(f"\n{missing} of {len(asked)} cases have no result")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
