"""How near the film's own resistance comes to the wanted one, on a plate and films that no part of the program wrote.

    ./peltier benchmark tracking [--seeds 5] [--first 10] [--only ROW,ROW] [--json FILE] [--workers 2]

The plant (`_tracked_plant`) is behind the emulated instruments, on the virtual clock: 30 J/K, 0.5 W/K, 0.05 V/K, 2 ohm,
25 degC, readings with 0.01 K and n = 0.002 decades of noise, at 10 Hz, 4 A. The model is what `calibrate` makes of it.
The target stays in the middle 80 % of the film's range: ramps of 0.01 decades/s between random levels, dwells of 30 s,
and a sine of 0.8 decades peak to peak in 300 s. Errors are those of the film itself, from the target's first row to its
last; of each row the median over the films is told beside what is asked. Steps that nobody announced: `benchmark
causal_steps`, of which the table has a short run.

    class, outside   a film of the model's class, a film of relays; the full law, and feedforward alone
    exact            a film of the class and its plate with their true parameters
    slopes           the same where S and R_e grow by 0.2 and 0.4 % a kelvin, which the law knows
    wrong            outside, the model of the nominal plate: S -20 %, R_e and G +20 %, room +5 K, thermometer 2 s late
    slow             a film of the class, 2 A
    repeat           outside, the third repetition
    memory           both films, begun inside the loop with an unknown memory and no hot excursion: the first 300 s,
                     the film on the other branch than the model says; beside it where four random turns have left it
    others           PID on log R at the best of four Ms; the paper's scheme: the inverse's temperatures, PID on the
                     temperature, at the best of two; looked up on the major loop
    own_gains        both films, law = "instrument_pid", gains as delivered and by `tune`
    steps            `causal_steps`, ten steps a film
    step_us          one step of the law from Python (`benchmark law_step`)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._harness import kept, options, side_by_side
from benchmarks._tracked_plant import NOISE_DEC
from benchmarks._tracking_runs import FILMS, Film, Found, Run, tracked

FULL, FEEDFORWARD = Run("full"), Run("feedforward", law="feedforward")
EXACT = Run("exact", exact=True), Run("exact_feedforward", law="feedforward", exact=True)
SLOPES = Run("sloped", exact=True, sloped=True), Run("sloped_feedforward", law="feedforward", exact=True, sloped=True)
PIDS = tuple(Run(f"pid_{ms}", law="pid", ms=ms) for ms in (1.2, 1.4, 1.7, 2.0))
PAPER = tuple(Run(f"paper_{ms}", way="inverse", ms=ms) for ms in (1.4, 1.7))
OWN = Run("delivered", law="instrument_pid"), Run("tuned", law="instrument_pid", tuned=True)
MEMORY = (
    Run("memory", memory="estimate"),
    Run("assumed", memory="assume"),
    Run("memory_turns", memory="estimate", left="turns"),
    Run("assumed_turns", memory="assume", left="turns"),
)
ROWS: dict[str, tuple[tuple[str, float, tuple[Run, ...]], ...]] = {
    "class": (("class", 4.0, (FULL, FEEDFORWARD)),),
    "outside": (("outside", 4.0, (FULL, FEEDFORWARD)),),
    "exact": (("class", 4.0, EXACT),),
    "slopes": (("class", 4.0, (*EXACT, *SLOPES)),),
    "wrong": (("outside", 4.0, (Run("wrong", wrong=True),)),),
    "slow": (("class", 2.0, (FULL,)),),
    "repeat": (("outside", 4.0, (Run("repeat", repeat=3),)),),
    "memory": (("class", 4.0, MEMORY), ("outside", 4.0, MEMORY)),
    "own_gains": (("class", 4.0, OWN), ("outside", 4.0, OWN)),
    "others": (("outside", 4.0, (*PIDS, *PAPER, Run("look_up", way="look_up"))),),
}
SHORT_STEPS = 10


@dataclass
class Line:
    """Of the table: what; asked (None: reported beside); values of each film, of which `of` makes one figure."""

    what: str
    asked: float | None
    values: list[float]
    unit: str = "n"
    of: Callable[[Iterable[float]], float] = np.median  # type: ignore[assignment]

    @property
    def measured(self) -> float:
        return float(self.of(self.values))


def films(rows: Iterable[str], seeds: Iterable[int], noise: float) -> list[Film]:
    """Each film once, with the runs of all rows that are on it."""
    runs: dict[tuple[str, float], dict[str, Run]] = {}
    for row in rows:
        for kind, current_A, each in ROWS.get(row, ()):
            runs.setdefault((kind, current_A), {}).update({run.name: run for run in each})
    return [
        Film(kind, seed, tuple(each.values()), current_A, noise)
        for (kind, current_A), each in runs.items()
        for seed in seeds
    ]


def lines(found: list[Found]) -> list[Line]:
    """The table's lines from what there is."""

    def of(kind: str, name: str, current_A: float = 4.0, which: int = 0) -> list[float]:
        there = [f for f in found if (f.film.kind, f.film.current_A) == (kind, current_A) and name in f.errors]
        return [f.errors[name][which] for f in there]

    def over(one: list[float], other: list[float]) -> list[float]:
        return [a / b for a, b in zip(one, other, strict=False)]

    def decades(values: list[float]) -> list[float]:
        return [NOISE_DEC * value for value in values]

    against = over(of("class", "full"), of("class", "feedforward"))
    against += over(of("outside", "full"), of("outside", "feedforward"))
    against += over(of("class", "exact"), of("class", "exact_feedforward"))
    slopes = over(of("class", "sloped"), of("class", "exact"))
    slopes_ahead = over(of("class", "sloped_feedforward"), of("class", "exact_feedforward"))
    table = [
        Line("RMS, film of the class", 0.25, of("class", "full")),
        Line("RMS, film outside the class", 0.50, of("outside", "full")),
        Line("feedforward alone, of the class", None, of("class", "feedforward")),
        Line("feedforward alone, outside", None, of("outside", "feedforward")),
        Line("nothing wrong: full", None, of("class", "exact")),
        Line("slopes that the law knows: full, over without them", None, slopes, ""),
        Line("slopes that the law knows: feedforward, the same", None, slopes_ahead, ""),
        Line("wrong: RMS", 0.8, of("outside", "wrong")),
        Line("wrong: largest error", 0.010, decades(of("outside", "wrong", which=1)), "dec"),
        Line("2 A, film of the class", 0.6, of("class", "full", 2.0)),
        Line("full over feedforward, the most", 1.05, against, "", max),
        Line("largest error, outside (the paper: 0.135)", 0.004, decades(of("outside", "full", which=1)), "dec"),
        Line("third repetition, outside", 0.40, of("outside", "repeat")),
    ]
    memory = [value for kind in FILMS for value in over(of(kind, "memory"), of(kind, "assumed"))]
    table.append(Line("unknown memory: with its estimate over without", 1.0 / 3.0, memory, ""))
    table += [
        Line(f"unknown memory, {kind}: the same", None, over(of(kind, "memory"), of(kind, "assumed")), "")
        for kind in FILMS
    ]
    table += [
        Line(f"unknown memory, {kind}: {name}", None, of(kind, run))
        for kind in FILMS
        for name, run in (
            ("estimated", "memory"),
            ("assumed", "assumed"),
            ("estimated, after turns", "memory_turns"),
            ("assumed, after turns", "assumed_turns"),
        )
    ]
    for kind in FILMS:
        table.append(Line(f"setpoints, gains as delivered, {kind}", None, of(kind, "delivered")))
        table.append(Line(f"setpoints, gains by tune, {kind}", 0.8, of(kind, "tuned")))
    for name, each in (("PID on log R at its best Ms", PIDS), ("the paper's scheme, tuned", PAPER)):
        tried = [of("outside", run.name) for run in each]
        table.append(Line(name, None, min((t for t in tried if t), key=np.median, default=[])))
    table.append(Line("looked up on the major loop", None, of("outside", "look_up")))
    return [line for line in table if line.values]


def told(line: Line) -> str:
    """A line of the table, as text."""
    asked = f"{line.asked:.3g}" if line.asked is not None else "-"
    met = "" if line.asked is None or line.measured <= line.asked else "  <- not met"
    spread = f"{min(line.values):.3g} to {max(line.values):.3g}"
    return f"{line.what:52s} {asked:>6s} {line.measured:8.3g} {line.unit:4s} {spread:>16s}{met}"


def step_lines(seeds: int, first: int, workers: int) -> list[Line]:
    """Of `causal_steps`, a short run."""
    from benchmarks.causal_steps import ASKED, Rows, measured

    table: list[Line] = []
    with ProcessPoolExecutor(workers) as pool:
        for name, asked in ASKED.items():
            rows: Rows = measured(pool, name, range(first, first + seeds), SHORT_STEPS)
            if asked.overshoot_dec is not None:
                table.append(Line(f"overshoot, {name}: largest", asked.overshoot_dec, rows.overshoot_dec, "dec", max))
            table.append(Line(f"causal step over the fastest, {name}: median", asked.median, rows.over_fastest, ""))
            table.append(Line(f"causal step over the fastest, {name}: most", asked.most, rows.over_fastest, "", max))
    return table


def main() -> int:
    rows = (*ROWS, "steps", "step_us")
    asked = options(__doc__, only=rows, seeds=5, first=10, noise=1.0)
    cases = films(asked.only, range(asked.first, asked.first + asked.seeds), asked.noise)
    found: list[Found] = []
    for each in side_by_side(tracked, cases, asked.workers):
        found.append(each)
        words = "  ".join(f"{name} {rms:.2f} ({most:.2f})" for name, (rms, most) in each.errors.items())
        at = each.film
        print(f"{at.kind} {at.seed}, {at.current_A:g} A: RMS (largest), n: {words} {each.text}", flush=True)
        for run in at.runs:
            if run.repeat > 1 and run.name in each.repetitions:
                print("    repetitions " + ", ".join(f"{rms:.2f}" for rms in each.repetitions[run.name]))
    table = lines(found)
    if "steps" in asked.only:
        table += step_lines(asked.seeds, asked.first, asked.workers)
    if "step_us" in asked.only:
        from benchmarks.law_step import median_us

        table.append(Line("one step of the law from Python", 25.0, [median_us("full") for _ in range(3)], "us"))
    print(f"\n{'n = 0.002 decades':52s} {'asked':>6s} {'measured':>8s}      {'of all films':>16s}")
    for line in table:
        print(told(line))
    kept(asked.json, [{**vars(line), "of": None, "measured": line.measured} for line in table])
    return 0 if all(not each.text for each in found) else 1


if __name__ == "__main__":
    sys.exit(main())
