"""The diagnosis of now beside that of an earlier commit: the same unseen records, at the same time, a core each.

    ./peltier benchmark diagnosis_before --before COMMIT [--kinds one,two,...] [--seeds 2] [--first 0] [--results FILE]
                                         [--tree FOLDER] [--table]

Each kind of blind case has `--seeds` cases from `--first` on, without their records of another profile. Both programs
diagnose a case at once, each in a process of its own with one thread, and what their processors worked is compared:
without what they compiled, which belongs to the first records of an installation. What each says is scored as in
`benchmark diagnosis`, and where one is right and the other wrong is told. A follow-up of a case is not diagnosed: what
decides there is not counted. The earlier commit is taken from git into `--tree` (a folder for temporary files by
default), with the packages of now. A case is a line of the results file; started again, the benchmark goes on.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks._asked_program import Program  # noqa: E402
from benchmarks.diagnosis import Job, key_of, read  # noqa: E402
from tests.sim.diagnosis.cases import KINDS as ALL_KINDS  # noqa: E402
from tests.sim.diagnosis.cases import case  # noqa: E402
from tests.sim.diagnosis.score import Row, score  # noqa: E402

KINDS = tuple(kind for kind in ALL_KINDS if kind not in ("smallest", "unlike"))  # those have choices besides a seed
# What is compared, which percentile of the times it is, and what is asked of it over the program of then.
ASKED = (("median", 50.0, 0.6), ("95th percentile", 95.0, 0.3), ("longest", 100.0, 0.2))
NAMES = ("before", "now")


def tree_of(commit: str, tree: Path | None) -> Path:
    """The sources of a commit, out of git's archive."""
    wanted = subprocess.run(["git", "rev-parse", commit], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    folder = tree or Path(tempfile.gettempdir()) / f"peltier-{wanted[:12]}"
    if not (folder / "sim").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        archive = subprocess.Popen(["git", "archive", wanted.strip()], cwd=ROOT, stdout=subprocess.PIPE)
        subprocess.run(["tar", "-x", "-C", str(folder)], stdin=archive.stdout, check=True)
        if archive.wait() != 0:
            sys.exit(f"benchmark: git has no archive of {commit}")
    return folder


def both(job: Job, programs: dict[str, Program]) -> Row:
    """One case, told to both programs at once."""
    truth = case(job["kind"], job["seed"])
    for program in programs.values():
        program.ask(truth.columns, truth.options)
    row: Row = {"key": key_of(job), "kind": truth.kind, "seed": truth.seed, "hidden": sorted(truth.hidden)}
    row["rows"] = int(truth.columns["time_s"].size)
    for name, program in programs.items():
        said = program.answer()
        found = score(truth, said["document"]) if said["document"] else {"named": [], "verdict": said["fault"]}
        row[name] = {
            "cpu_s": said["cpu_s"],
            "compiled_s": said["compiled_s"],
            **{what: found.get(what) for what in ("ok", "named", "verdict")},
        }
    return row


def table(rows: list[Row], before: str) -> None:
    """Times of both, and who is right."""
    times = {name: [row[name]["cpu_s"] for row in rows] for name in NAMES}
    print(f"\n{len(rows)} records, seconds of a processor      {before[:12]:>12}         now   ratio   asked")
    for what, percent, asked in ASKED:
        old, now = (np.percentile(times[name], percent) for name in NAMES)
        print(f"{what:<45}{old:>8.1f}{now:>12.1f}{now / old:>8.2f}{asked:>8.1f}")
    ratios = [now / old for old, now in zip(times["before"], times["now"], strict=True)]
    print(f"{'each record over itself: median; largest':<65}{np.median(ratios):>8.2f}{max(ratios):>8.2f}")
    print(f"\n{'kind':<22}{'records':>8}{'before s':>10}{'now s':>8}{'right before':>14}{'now':>5}")
    for kind in KINDS:
        of_kind = [row for row in rows if row["kind"] == kind]
        if of_kind:
            took = [np.median([row[name]["cpu_s"] for row in of_kind]) for name in NAMES]
            right = [sum(bool(row[name]["ok"]) for row in of_kind) for name in NAMES]
            print(f"{kind:<22}{len(of_kind):>8}{took[0]:>10.1f}{took[1]:>8.1f}{right[0]:>14}{right[1]:>5}")
    for row in rows:
        if bool(row["before"]["ok"]) != bool(row["now"]["ok"]):
            said = [f"{row[name]['named'] or row[name]['verdict']}" for name in NAMES]
            print(f"differs: {row['kind']} {row['seed']}, hidden {row['hidden']}: before {said[0]}, now {said[1]}")


def add_cases(parser: argparse.ArgumentParser, seeds: int, results: str) -> None:
    """Which blind cases, and where what came out is kept."""
    parser.add_argument("--kinds", default=",".join(KINDS), help=f"of {', '.join(KINDS)}")
    parser.add_argument("--seeds", type=int, default=seeds, help="cases of each kind")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--results", type=Path, default=Path(results))
    parser.add_argument("--table", action="store_true", help="only print the table of what is there")


def cases_of(
    options: argparse.Namespace, parser: argparse.ArgumentParser
) -> tuple[list[Job], dict[str, Row], list[Job]]:
    """The cases asked for, the rows that there are by key, and the cases that are to be done."""
    kinds = options.kinds.split(",")
    if unknown := set(kinds) - set(KINDS):
        parser.error(f"unknown kinds {', '.join(sorted(unknown))}: of {', '.join(KINDS)}")
    seeds = range(options.first, options.first + options.seeds)
    jobs: list[Job] = [{"kind": kind, "seed": seed, "choice": {}} for seed in seeds for kind in kinds]
    done = read(options.results, {key_of(job) for job in jobs})
    return jobs, done, [] if options.table else [job for job in jobs if key_of(job) not in done]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", required=True, help="the commit")
    add_cases(parser, 2, "diagnosis_before.jsonl")
    parser.add_argument("--tree", type=Path, help="where the earlier sources are, or are to be")
    options = parser.parse_args()
    jobs, done, todo = cases_of(options, parser)
    if todo:
        before = tree_of(options.before, options.tree)
        with tempfile.TemporaryDirectory() as made, options.results.open("a", encoding="utf-8") as file:
            folder = Path(made)
            programs = {
                "before": Program(before, folder / "before", {"NUMBA_CACHE_DIR": str(before / ".compiled")}),
                "now": Program(ROOT, folder / "now"),
            }
            for count, job in enumerate(todo, 1):
                row = done[key_of(job)] = both(job, programs)
                file.write(json.dumps(row, default=float) + "\n")
                file.flush()
                took = " and ".join(f"{row[name]['cpu_s']:.1f} s ({row[name]['ok']})" for name in NAMES)
                print(f"{count}/{len(todo)} {row['key']}: {took}", file=sys.stderr, flush=True)
            for program in programs.values():
                program.end()
    table([done[key_of(job)] for job in jobs if key_of(job) in done], options.before)
    return 0 if len(done) == len(jobs) else 1


if __name__ == "__main__":
    sys.exit(main())
