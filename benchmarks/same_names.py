"""The same names whatever the last digit is: readings moved by 1e-12 of themselves, and another processor's sums.

    ./peltier benchmark same_names [--kinds one,two,...] [--seeds 1] [--first 0] [--results FILE] [--table]

Each blind case is diagnosed four times: as it is, with every reading moved by a random 1e-12 of itself, and both again
with the instructions of another processor (`.ci/narrower_instructions.py`). Asked: the same names. Where the verdict
differs beside the same names, that is told, too. A case is a line of the results file; started again, the benchmark
goes on.
"""

from __future__ import annotations

import argparse
import json
import runpy
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks._asked_program import Program  # noqa: E402
from benchmarks.diagnosis import Job, key_of  # noqa: E402
from benchmarks.diagnosis_before import add_cases, cases_of  # noqa: E402
from tests.sim.diagnosis.cases import case  # noqa: E402
from tests.sim.diagnosis.score import Row  # noqa: E402

MOVED = 1e-12  # of a reading
READINGS = ("temperature_degC", "resistance_ohm")


def moved(columns: dict[str, Any], seed: int) -> dict[str, Any]:
    """The record with each reading a random 1e-12 of itself away."""
    rng = np.random.default_rng(seed)
    return {
        name: np.asarray(values) * (1.0 + MOVED * rng.standard_normal(len(values))) if name in READINGS else values
        for name, values in columns.items()
    }


def four_times(job: Job, here: Program, elsewhere: Program) -> Row:
    """What is said of one case, twice by each program."""
    truth = case(job["kind"], job["seed"])
    row: Row = {"key": key_of(job), "kind": truth.kind, "hidden": sorted(truth.hidden), "said": {}}
    for how, columns in (("as it is", truth.columns), ("moved", moved(truth.columns, truth.seed))):
        for program in (here, elsewhere):
            program.ask(columns, truth.options)
        for where, program in (("here", here), ("elsewhere", elsewhere)):
            answer = program.answer()
            document = answer["document"]
            names = sorted(found["name"] for found in document["effects"]) if document else [answer["fault"]]
            row["said"][f"{how}, {where}"] = [names, document["verdict"] if document else "failed"]
    return row


def table(rows: list[Row]) -> int:
    """How many are told the same; those that are not. Returns how many have other names."""
    apart = [row for row in rows if len({json.dumps(names) for names, _ in row["said"].values()}) > 1]
    verdicts = [row for row in rows if row not in apart and len({word for _, word in row["said"].values()}) > 1]
    print(f"\nthe same names four times: {len(rows) - len(apart)} of {len(rows)} records    asked: all")
    print(f"the same verdict besides:  {len(rows) - len(apart) - len(verdicts)}")
    for row in (*apart, *verdicts):
        print(f"differs: {row['key']}, hidden {row['hidden']}: {row['said']}")
    return len(apart)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_cases(parser, 1, "same_names.jsonl")
    options = parser.parse_args()
    jobs, done, todo = cases_of(options, parser)
    if todo:
        narrower = runpy.run_path(str(ROOT / ".ci" / "narrower_instructions.py"))["narrower"]()
        with tempfile.TemporaryDirectory() as made, options.results.open("a", encoding="utf-8") as file:
            here = Program(ROOT, Path(made) / "here")
            elsewhere = Program(ROOT, Path(made) / "elsewhere", narrower)
            for count, job in enumerate(todo, 1):
                row = done[key_of(job)] = four_times(job, here, elsewhere)
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(f"{count}/{len(todo)} {row['key']}: {row['said']}", file=sys.stderr, flush=True)
            here.end()
            elsewhere.end()
    apart = table([done[key_of(job)] for job in jobs if key_of(job) in done])
    return 0 if not apart and len(done) == len(jobs) else 1


if __name__ == "__main__":
    sys.exit(main())
