"""How near the film's own resistance comes to the wanted one, on a plate and films that no part of the program wrote.

    ./peltier benchmark tracking [--seeds 5] [--first 10] [--only ROW,ROW] [--json FILE] [--workers 2]

The plant (`tests/truth.py`) is behind the emulated instruments, on the virtual clock: 30 J/K, 0.5 W/K, 0.05 V/K, 2 ohm,
25 degC, readings with 0.01 K and n = 0.002 decades of noise, at 10 Hz, 4 A. The model is what `calibrate` makes of it.
The target stays in the middle 80 % of the film's range: ramps of 0.01 decades/s between random levels, dwells of 30 s,
and a sine of 0.8 decades peak to peak in 300 s. Errors are those of the film itself, from the target's first row to its
last; of each row the median over the films is told beside what is asked.

    class, outside   a film of the model's class, a film of relays; the full law, and feedforward alone
    exact            a film of the class and its plate with their true parameters
    wrong            outside, the model of the nominal plate: S -20 %, R_e and G +20 %, room +5 K, thermometer 2 s late
    repeat           outside, the third repetition
    memory           both films, begun inside the loop with an unknown memory and no hot excursion: the first 300 s, the
                     film on the other branch than the model says
    own_gains        both films, law = "instrument_pid", gains by `tune`
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks._bench import (
    CONFIGURATION,
    NOMINAL,
    SETTLE_S,
    WRONG,
    WRONG_LAG,
    calibrated,
    command,
    course,
    driven,
    error,
    middle_of,
    placed,
    write_target,
)
from benchmarks._harness import kept, options, side_by_side
from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.thermal.plate import PlateModel
from rig.config.configuration import read_configuration
from rig.config.model_file import Model, write_model
from rig.experiment.tracking import law_and_design
from tests.truth import FILMS, NOISE_DEC, Plant, parameters_of_the_class

UNKNOWN_S = 300.0


@dataclass(frozen=True)
class Run:
    """One run of a film: name, as the table knows it; wrong: on the wrong plate; exact: with film and plate as they
    are; tuned: with the controller's own gains by `peltier tune`; the rest as in the configuration."""

    name: str
    law: str = "full"
    wrong: bool = False
    exact: bool = False
    repeat: int = 1
    memory: str = ""
    tuned: bool = False


FULL, FEEDFORWARD = Run("full"), Run("feedforward", law="feedforward")
EXACT = Run("exact", exact=True), Run("exact_feedforward", law="feedforward", exact=True)
MEMORY = Run("memory", memory="estimate"), Run("assumed", memory="assume")
TUNED = Run("tuned", law="instrument_pid", tuned=True)
ROWS: dict[str, dict[str, tuple[Run, ...]]] = {  # of each row the runs by the kind of film
    "class": {"class": (FULL, FEEDFORWARD)},
    "outside": {"outside": (FULL, FEEDFORWARD)},
    "exact": {"class": EXACT},
    "wrong": {"outside": (Run("wrong", wrong=True),)},
    "repeat": {"outside": (Run("repeat", repeat=3),)},
    "memory": {"class": MEMORY, "outside": MEMORY},
    "own_gains": {"class": (TUNED,), "outside": (TUNED,)},
}


@dataclass
class Found:
    """Of a film: RMS and largest error in n, by the run's name; what went wrong."""

    kind: str
    seed: int
    errors: dict[str, tuple[float, float]] = field(default_factory=dict)
    text: str = ""


def tracked(case: tuple[str, int, tuple[Run, ...]]) -> Found:
    """Calibrate a film of a kind and a seed, then run each of the runs on it."""
    kind, seed, runs = case
    found = Found(kind, seed)
    with tempfile.TemporaryDirectory(prefix="tracking-") as folder:
        try:
            model = calibrated(Path(folder), FILMS[kind](seed), seed)
            for run in runs:
                found.errors[run.name] = one_run(found, run, model, Path(folder))
        except RuntimeError as ended:
            found.text = str(ended)
    return found


def one_run(found: Found, run: Run, model: Model, folder: Path) -> tuple[float, float]:
    """Return RMS and largest error of the film. Raises RuntimeError with what a run said that failed."""
    film, seed = FILMS[found.kind](found.seed), found.seed

    def plant(start_s: float) -> Plant:
        made = Plant(NOMINAL, film, seed, start_s)
        if run.memory:
            made.degC = made.shown_degC = made.lagged_degC = left_on_the_other_branch(made, seed)
            made.log_ohm = made.film.log_ohm(made.degC)
        return made

    first = None
    if run.memory:
        first = float(np.clip(plant(0.0).log_ohm, *middle_of(film)))
        assert model.film is not None
        model = replace(model, film=replace(model.film, initial="cooled"))
    times, values = course(film, seed, first)
    if run.memory:
        last, times = float(np.interp(UNKNOWN_S, times, values)), [t for t in times if t < UNKNOWN_S]
        times, values = [*times, UNKNOWN_S], [*values[: len(times)], last]
    if run.exact:
        model = exact_model(seed)
    if run.wrong:
        return wrong_error(found, model, folder, times, values)
    write_target(folder, times, values)
    write_model(folder / "model.toml", model)
    path, text = folder / f"{run.name}.toml", CONFIGURATION.format(model="model.toml", law=run.law)
    text = text.replace("[experiment]\n", f"[experiment]\nrepeat = {run.repeat}\n") if run.repeat > 1 else text
    if run.memory:  # no pulse: the film stays where somebody has left it
        text = text.replace("[limits]\n", "[limits]\npolarity_share = 0.0\n")
        text = text.replace("[experiment]\n", f'[experiment]\nmemory = "{run.memory}"\n')
    path.write_text(text)
    if run.tuned:
        path.write_text(text + own_gains(path))
    ended = command(["run", path, "--out", folder / run.name], plant)
    if ended.status:
        raise RuntimeError(f"{run.name}: {ended.said}")
    return error(ended.plants[-1], ended.begin_s[-1], times, values)


def left_on_the_other_branch(plant: Plant, seed: int) -> float:
    """Heat the film from the cold to a random level of its middle, where a model that says `initial = "cooled"`, as the
    format has it by default, has every operator elsewhere. Return the temperature there, degC."""
    level, degC = random.Random(1000 + seed).uniform(*middle_of(plant.film.film)), 25.0
    while plant.film.log_ohm(degC) > level:
        degC += 0.02
    return degC


def exact_model(seed: int) -> Model:
    """A film of the class and its plate as they are."""
    a, rising, falling, radii, weights, offset, slope = parameters_of_the_class(seed)
    rises, falls = Envelope("tanh", a, -a * rising), Envelope("tanh", a, -a * falling)
    film = FilmModel(radii, weights, rises, falls, Memoryless("linear", 1.0, slope, -60.0 * slope, -offset))
    p = NOMINAL
    return Model(film, PlateModel(*(x / p.capacity for x in (p.seebeck, p.resistance, p.conductance)), p.ambient_degC))


def own_gains(path: Path) -> str:
    """The driver's options that `peltier tune` gives, as a table of the configuration."""
    from rig.__main__ import main

    told = path.with_suffix(".json")
    with contextlib.redirect_stdout(io.StringIO()):
        main(["tune", str(path), "--json", str(told)])
    gains = json.loads(told.read_text())["instrument_pid_gains"]["options"]
    return "[bench.controller.options]\n" + "".join(f"{key} = {value!r}\n" for key, value in gains.items())


def wrong_error(
    found: Found, model: Model, folder: Path, times: list[float], values: list[float]
) -> tuple[float, float]:
    """RMS and largest error on the wrong plate, beside the plant: `_bench` tells why."""
    assert model.film is not None
    assert model.plate is not None
    plant = Plant(WRONG, FILMS[found.kind](found.seed), found.seed, 0.0, WRONG_LAG)
    law, _ = law_and_design("full", read_configuration(folder / "config.toml").content, model.film, model.plate)
    state = placed(plant, law, model.film, values[0])
    driven(plant, law, state, lambda t: np.interp(t - SETTLE_S, times, values), SETTLE_S + times[-1])
    return error(plant, SETTLE_S, times, values)


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

    def __str__(self) -> str:
        asked = f"{self.asked:.3g}" if self.asked is not None else "-"
        met = "" if self.asked is None or self.measured <= self.asked else "  <- not met"
        spread = f"{min(self.values):.3g} to {max(self.values):.3g}"
        return f"{self.what:52s} {asked:>6s} {self.measured:8.3g} {self.unit:4s} {spread:>16s}{met}"


def lines(found: list[Found]) -> list[Line]:
    """The table's lines from what there is."""

    def of(kind: str, name: str, which: int = 0, unit: float = 1.0) -> list[float]:
        return [unit * f.errors[name][which] for f in found if f.kind == kind and name in f.errors]

    def over(kind: str, one: str, other: str) -> list[float]:
        return [a / b for a, b in zip(of(kind, one), of(kind, other), strict=False)]

    against = over("class", "full", "feedforward") + over("outside", "full", "feedforward")
    against += over("class", "exact", "exact_feedforward")
    table = [
        Line("RMS, film of the class", 0.25, of("class", "full")),
        Line("RMS, film outside the class", 0.50, of("outside", "full")),
        Line("feedforward alone, of the class", None, of("class", "feedforward")),
        Line("feedforward alone, outside", None, of("outside", "feedforward")),
        Line("nothing wrong: full", None, of("class", "exact")),
        Line("wrong: RMS", 0.8, of("outside", "wrong")),
        Line("wrong: largest error", 0.010, of("outside", "wrong", 1, NOISE_DEC), "dec"),
        Line("full over feedforward, the most", 1.05, against, "", max),
        Line("largest error, outside (the paper: 0.135)", 0.004, of("outside", "full", 1, NOISE_DEC), "dec"),
        Line("third repetition, outside", 0.40, of("outside", "repeat")),
    ]
    for kind in FILMS:
        over_without = over(kind, "memory", "assumed")
        table.append(Line(f"unknown memory, {kind}: its estimate over without", 1.0 / 3.0, over_without, ""))
        table.append(Line(f"setpoints, gains by tune, {kind}", 0.8, of(kind, "tuned")))
    return [line for line in table if line.values]


def main() -> int:
    asked = options(__doc__, only=tuple(ROWS), seeds=5, first=10)
    runs: dict[str, dict[str, Run]] = {kind: {} for kind in FILMS}
    for row in asked.only:
        for kind, each in ROWS[row].items():
            runs[kind].update({run.name: run for run in each})
    seeds = range(asked.first, asked.first + asked.seeds)
    cases = [(kind, seed, tuple(each.values())) for kind, each in runs.items() if each for seed in seeds]
    found: list[Found] = []
    for each in side_by_side(tracked, cases, asked.workers):
        found.append(each)
        words = "  ".join(f"{name} {rms:.2f} ({most:.2f})" for name, (rms, most) in each.errors.items())
        print(f"{each.kind} {each.seed}: RMS (largest), n: {words} {each.text}", flush=True)
    table = lines(found)
    print(f"\n{'n = 0.002 decades':52s} {'asked':>6s} {'measured':>8s}      {'of all films':>16s}")
    print(*table, sep="\n")
    kept(asked.json, [{**vars(line), "of": None, "measured": line.measured} for line in table])
    return 0 if all(not each.text for each in found) else 1


if __name__ == "__main__":
    sys.exit(main())
