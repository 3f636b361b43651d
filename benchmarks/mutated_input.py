"""Bad input ends in one clear line: mutated inputs over all verbs and files, and over HTTP.

    ./peltier benchmark mutated_input [--count 10000] [--http 10000] [--first N] [--json FILE]

Good inputs (configurations, records, models, targets, effects of one's own, run folders, words on the command line)
are changed by bytes and by structure, and given to a verb: each in a process of its own, forked from one that has
everything loaded. The HTTP half is sent to a daemon's page and to STOP's own listener: methods, addresses, headers,
bodies. Wrong is a traceback, an end by a signal, a status that is not documented, a 500, and whatever takes over 60 s.
Asked: none. What is wrong is printed with its seed; --first N --count 1 does that one again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._good_inputs import RIGS, lay_out
from benchmarks._mutated_requests import LONGEST_S, over_http
from benchmarks._mutations import DIGITS, mutated
from rig.__main__ import main as peltier

ENDS_S = 1.5  # verbs that run until they are stopped are stopped after this
PATIENCE_S = 30.0  # and an experiment that a mutation has made long after this
ENDLESS = {"emulate", "serve"}
LONG = {"run", "calibrate", "simulate", "sweep", "replay", "check"}
MEMORY = 8 << 30  # bytes of address space: beyond it, an input made something much too large
DOCUMENTED = {0, 1, 2, 10, 11, 75, 128 + signal.SIGTERM}
TRACEBACK = 99
ANSWERS = [["--json", "-"], ["--json", "out.json"], ["--json", "no/such/folder.json"], ["--json", "config.toml"], []]
OUTS = ["out", "out.csv", "taken", "link", "dangling", "no/such/out", "/", "x" * 300, "new/deep", "a?b#c%41"]
WORDS = ["0", "-1", "1e308", "nan", DIGITS, "", "é", "a=b", "temperature_degC=T@K", "film_lag:tau_s=1e308", "-50,200"]


@dataclass(frozen=True)
class Case:
    """A verb with its words, and the one file that is made bad (or none)."""

    verb: str
    words: tuple[str, ...]
    files: tuple[str, ...]


CASES = [
    Case("run", ("config.toml", "--out", "OUT"), ("config.toml", "model.toml")),
    Case("run", ("profile.toml", "--out", "OUT"), ("profile.toml", "target.csv")),
    Case("calibrate", ("config.toml", "--out", "OUT"), ("config.toml",)),
    Case("identify", ("record.csv", "--out", "OUT", "--operators", "4"), ("record.csv",)),
    Case("identify", ("record.csv", "--column=WORD", "--kind", "generalized_pi", "--operators=WORD"), ("record.csv",)),
    Case("identify", ("record.xlsx", "--out", "OUT", "--operators", "4"), ("record.xlsx",)),
    Case("identify", ("record.mat", "--kind", "generalized_pi", "--operators", "4"), ("record.mat",)),
    Case("predict", ("model.toml", "record.xlsx", "--out", "OUT"), ("record.xlsx",)),
    Case("predict", ("model.toml", "record.mat", "--column=WORD"), ("record.mat",)),
    Case("predict", ("model.toml", "wide.txt", "--column=WORD"), ("wide.txt",)),
    Case("predict", ("model.toml", "western.txt", "--out", "OUT"), ("western.txt",)),
    Case("predict", ("model.toml", "record.csv", "--out", "OUT"), ("model.toml", "record.csv")),
    Case("predict", ("model.toml", "record.csv", "--initial", "fitted", "--column=WORD"), ("model.toml", "record.csv")),
    Case("diagnose", ("short.csv", "--report", "OUT"), ("short.csv",)),
    Case("invert", ("model.toml", "target.csv", "--out", "OUT"), ("model.toml", "target.csv")),
    Case("invert", ("model.toml", "target.csv", "--limits=WORD"), ("model.toml", "target.csv")),
    Case("simulate", ("config.toml", "--out", "OUT"), ("config.toml", "model.toml")),
    Case("simulate", ("current.toml", "--effect-file=own.py", "--effect=plate_fin", "--out", "OUT"), ("own.py",)),
    Case("simulate", ("current.toml", "--out", "OUT", "--effect=WORD"), ("current.toml", "model.toml")),
    Case("simulate", ("current.toml", "--out", "OUT", "--seed=WORD"), ("current.toml", "target.csv")),
    Case(
        "replay", ("run",), ("run/run.json", "run/record.csv", "run/events.jsonl", "run/config.toml", "run/model.toml")
    ),
    Case("replay", ("run", "--config", "config.toml", "--out", "OUT"), ("config.toml", "run/model.toml")),
    *(Case("run", (f"{name}.toml", "--out", "OUT"), (f"{name}.toml",)) for name in RIGS),
    *(Case("check", (f"{name}.toml",), (f"{name}.toml",)) for name in RIGS),
    Case("off", ("visa.toml",), ("visa.toml",)),
    Case("tune", ("config.toml",), ("config.toml", "model.toml")),
    Case("check", ("config.toml",), ("config.toml",)),
    Case("off", ("config.toml",), ("config.toml",)),
    Case("emulate", ("config.toml", "--speed=WORD"), ("config.toml",)),
    Case("serve", ("config.toml",), ("config.toml",)),
    Case("sweep", ("config.toml", "--out", "OUT", "--workers", "1"), ("config.toml",)),
    Case("init", ("OUT",), ()),
    Case("reset", ("--reason=WORD"), ()),
    Case("ports", ("WORD",), ()),
]
RARE = {
    "sweep": 0.1,
    "own.py": 0.05,
    "serve": 0.2,
    "calibrate": 0.2,
    "emulate": 0.4,
    "init": 0.2,
    "reset": 0.2,
    "ports": 0.2,
    "diagnose": 0.5,
}


def warm_up(folder: Path) -> None:
    """Each verb once with good inputs, so that what is forked has everything loaded and compiled."""
    here = os.getcwd()
    os.chdir(folder)
    try:
        for case in CASES:
            if case.verb not in ("emulate", "serve", "sweep", "init", "run", "ports", "calibrate", "reset"):
                words = [f"warm-{k}" if w == "OUT" else w for k, w in enumerate(case.words) if "WORD" not in w]
                peltier([case.verb, *words])
                for name in [word for word in words if word.startswith("warm-")]:
                    shutil.rmtree(name, ignore_errors=True)
                    Path(name).unlink(missing_ok=True)
    finally:
        os.chdir(here)


def one(number: int, good: Path, folder: Path) -> tuple[str, int, str, float]:
    """(what was done, exit status or TRACEBACK, stderr, seconds) of one mutated input."""
    chance = random.Random(number)
    while True:
        case = chance.choice(CASES)
        if chance.random() < RARE.get("own.py" if "own.py" in case.files else case.verb, 1.0):
            break
    out = chance.choice(OUTS) if chance.random() < 0.1 else "new"  # else the file's faults would hide behind it
    bad_words = not case.files or chance.random() < 0.4  # else their faults, too, would hide the file's
    words = [w for w in case.words if bad_words or "=WORD" not in w]
    words = [w.replace("OUT", out).replace("WORD", chance.choice(WORDS)) for w in words]
    words += (
        chance.choice(ANSWERS if chance.random() < 0.1 else ANSWERS[:2])
        if case.verb not in ("emulate", "serve", "init", "reset")
        else []
    )
    shutil.copytree(good, folder, symlinks=True)
    name = ""
    if case.files and chance.random() < 0.93:
        name = chance.choice(case.files)
        content = (folder / name).read_bytes()
        for _ in range(chance.choice([1, 1, 1, 2])):
            content = mutated(name, content, chance)
        (folder / name).write_bytes(content)
    begin = time.monotonic()
    status = _forked([case.verb, *words], folder)
    took_s = time.monotonic() - begin
    said = (folder / "stderr").read_text(errors="replace")
    shutil.rmtree(folder)
    return f"{case.verb} {' '.join(words)[:100]} [{name}]", status, said, took_s


def _forked(words: list[str], folder: Path) -> int:
    """The exit status of the verb in a process of its own; -n where signal n ended it."""
    child = os.fork()
    if child == 0:
        _child(words, folder)
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -signal.SIGKILL


def _child(words: list[str], folder: Path) -> None:
    status = TRACEBACK
    try:
        os.setsid()
        os.chdir(folder)
        os.environ["PELTIER_SOCKET"] = str(folder / "bench.sock")
        for number, name, mode in (
            (0, os.devnull, os.O_RDONLY),
            (1, "stdout", os.O_CREAT | os.O_WRONLY),
            (2, "stderr", os.O_CREAT | os.O_WRONLY),
        ):
            os.dup2(os.open(name, mode), number)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        if words[0] in ENDLESS | LONG:
            signal.setitimer(signal.ITIMER_REAL, ENDS_S if words[0] in ENDLESS else PATIENCE_S)
            signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGTERM))
        status = peltier(words)
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(status)


def wrong_with(status: int, said: str) -> str:
    """What is wrong with how a verb ended; nothing where nothing is."""
    if status == TRACEBACK or "Traceback (most recent call last)" in said:
        return f"traceback: {said.strip().splitlines()[-1][:200] if said.strip() else ''}"
    if status == -signal.SIGKILL:
        return f"longer than {LONGEST_S:g} s, or killed"
    if status not in DOCUMENTED:
        return f"status {status}"
    if status == 2 and not said.strip():
        return f"status {status} without a line"
    return ""


def verbs(first: int, count: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """So many mutated inputs over the verbs, in one process after the other, two at a time."""
    statuses: Counter[int] = Counter()
    wrong, longest_s = [], 0.0
    with tempfile.TemporaryDirectory() as temporary:
        good = Path(temporary) / "good"
        good.mkdir()
        lay_out(good)
        warm_up(good)
        for number in range(first, first + count):
            what, status, said, took_s = one(number, good, Path(temporary) / f"case{number}")
            statuses[status] += 1
            longest_s = max(longest_s, took_s)
            if fault := wrong_with(status, said):
                wrong.append(f"{number}: {what}: {fault}")
                tell(f"WRONG {wrong[-1]}\n{said[-1500:]}")
    return {"inputs": count, "statuses": dict(sorted(statuses.items())), "wrong": wrong, "longest_s": longest_s}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--http", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="seed of the first input")
    parser.add_argument("--json")
    options = parser.parse_args()
    figures = {}
    if options.count:
        tell = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
        figures["verbs"] = verbs(options.first, options.count, tell)
    if options.http:
        figures["http"] = over_http(options.first, options.http)
    for name, found in figures.items():
        print(
            f"{name}: {found['inputs']} mutated inputs, {len(found['wrong'])} wrong (asked: 0), the longest took "
            f"{found['longest_s']:.1f} s (asked: 60); by status: {found['statuses']}"
        )
        for line in found["wrong"][:50]:
            print(f"  {line}")
    if options.json:
        Path(options.json).write_text(json.dumps(figures, indent=1) + "\n")
    return 1 if any(found["wrong"] for found in figures.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
