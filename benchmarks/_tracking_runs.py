"""What one film of `benchmark tracking` gives: calibrated once, then run by each law that a row asks for.

Plant and films are `_tracked_plant`'s and `_hidden_effects`', behind the emulated instruments, on the virtual clock.
Errors are those of the film itself, in n = `NOISE_DEC` decades, from the target's first row to its last.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import random
import shutil
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks._beside_the_plant import driven, placed
from benchmarks._hidden_effects import EffectPlant, Hidden
from benchmarks._left_films import COLD_DEGC, HOT_DEGC, leave_behind, middle_of, span, up_to
from benchmarks._own_plant import SIMULATED_BENCH, behind_the_instruments, noted_phase
from benchmarks._tracked_plant import NOISE_DEC, FilmOfTheClass, FilmOutsideTheClass, Plate, TrackedPlant
from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from rig.config.configuration import read_configuration
from rig.config.model_file import Model, read_model, write_model
from rig.experiment.tracking import law_and_design

RATE_DEC_PER_S, DWELL_S, LEVELS = 0.01, 30.0, 6
SINE_DEC, SINE_S = 0.8, 300.0
FILMS = {"class": FilmOfTheClass, "outside": FilmOutsideTheClass}
NOMINAL = Plate()
WRONG = Plate(seebeck=0.04, resistance=2.4, conductance=0.6, ambient_degC=30.0)  # S -20 %, R_e, G +20 %, room +5 K
SLOPED = Plate(seebeck_slope=0.002, resistance_slope=0.004)
WRONG_LAG_S, SETTLE_S = 2.0, 30.0
FROM_HOT_S = 90.0  # of a wanted temperature: the way down from the hot end, before the target begins
UNKNOWN_S = 300.0

CONFIGURATION = (
    SIMULATED_BENCH
    + """
[limits]
temperature_degC = [10, 95]
current_A = {current}
[experiment]
kind = "track_resistance"
target = "target.csv"
model = "{model}"
law = "{law}"
period_s = 0.1
[calibration]
temperature_degC = [{low}, {high}]
rate_K_per_s = 0.7
minor_loops = 8
dwell_s = 2.0
"""
)


@dataclass(frozen=True)
class Run:
    """One run of a film: name, as the table knows it; way: how the target is given (`resistance`, or as a temperature
    by `inverse` or `look_up`); left: how somebody has left the film (`leave_behind`); sloped: whether the plate's S and
    R_e change with temperature, exact: whether the law has the film and the plate as they are; tuned: with the
    controller's own gains by `peltier tune`; the rest as in the configuration."""

    name: str
    law: str = "full"
    wrong: bool = False
    exact: bool = False
    sloped: bool = False
    way: str = "resistance"
    ms: float | None = None
    repeat: int = 1
    memory: str = ""
    left: str = "other branch"
    tuned: bool = False


@dataclass(frozen=True)
class Film:
    """One film of a kind, by its seed, with a current limit, and what is run on it."""

    kind: str
    seed: int
    runs: tuple[Run, ...]
    current_A: float = 4.0
    noise: float = 1.0


@dataclass
class Found:
    """Of a film: RMS and largest error in n, by the run's name; repetition by repetition; what went wrong."""

    film: Film
    errors: dict[str, tuple[float, float]] = field(default_factory=dict)
    repetitions: dict[str, list[float]] = field(default_factory=dict)
    text: str = ""


def course(low: float, high: float, seed: int, first: float | None = None) -> tuple[list[float], list[float]]:
    """Times and wanted log10 R within the middle 80 % of a range; first: where it begins."""
    chance = random.Random(seed)
    low, high = low + 0.1 * (high - low), high - 0.1 * (high - low)
    times, values = [0.0, 10.0], [high - 0.3 * (high - low) if first is None else first] * 2

    def to(value: float) -> None:
        times.append(times[-1] + abs(value - values[-1]) / RATE_DEC_PER_S + 1.0)
        values.append(value)
        times.append(times[-1] + DWELL_S)
        values.append(value)

    for _ in range(LEVELS):
        to(chance.uniform(low, high))
    middle = 0.5 * (low + high)
    to(middle)
    begin = times[-1]
    for k in range(1, 601):
        times.append(begin + k * SINE_S / 600)
        values.append(middle + 0.5 * SINE_DEC * math.sin(2.0 * math.pi * k / 600))
    return times, values


def plant_of(film: Film, run: Run, start_s: float) -> TrackedPlant:
    """The film on its plate, fresh from the cold; for a run of unknown memory as somebody has left it."""
    true = FILMS[film.kind](film.seed)
    if run.wrong:
        return EffectPlant(WRONG, true, film.seed, start_s, Hidden(sensor_lag_s=WRONG_LAG_S), film.noise)
    plant = TrackedPlant(SLOPED if run.sloped else NOMINAL, true, film.seed, start_s, film.noise)
    if run.memory:
        plant.degC = leave_behind(true, film.seed, run.left)
        plant.log_ohm = true.log_ohm(plant.degC)
    return plant


def exact_model(film: Film, p: Plate) -> Model:
    """A film of the class and its plate as they are."""
    a, rising, falling, radii, weights, offset, slope = FilmOfTheClass(film.seed).parameters()
    model = FilmModel(
        radii,
        weights,
        Envelope("tanh", a, -a * rising),
        Envelope("tanh", a, -a * falling),
        Memoryless("linear", 1.0, slope, -60.0 * slope, -offset),
    )
    plate = PlateModel(
        p.seebeck / p.capacity,
        p.resistance / p.capacity,
        p.conductance / p.capacity,
        p.ambient_degC,
        seebeck_slope_per_K=p.seebeck_slope,
        resistance_slope_per_K=p.resistance_slope,
    )
    return Model(model, plate)


def tracked(film: Film) -> Found:
    """Calibrate, then every run."""
    folder, found = Path(tempfile.mkdtemp(prefix="tracking-")), Found(film)
    (folder / "target.csv").write_text("time_s,target_ohm\n0,1e4\n1,1e4\n")
    try:
        found.text = Bench(film, Run("cal"), folder).command("calibrate", "target.csv")
        if not found.text:
            shutil.copy(folder / "cal" / "MODEL.toml", folder / "MODEL.toml")
            for run in film.runs:
                found.text += one_run(film, run, folder, found)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return found


def one_run(film: Film, run: Run, folder: Path, found: Found) -> str:
    """Its errors into `found`; what went wrong, or nothing."""
    first, before_s, model = None, 0.0, "MODEL.toml"
    if run.memory:
        low, high = middle_of(FILMS[film.kind](film.seed))
        first = min(max(plant_of(film, run, 0.0).log_ohm, low), high)
    times, values = course(*span(FILMS[film.kind](film.seed)), film.seed, first)
    if run.memory:
        times, values = up_to(UNKNOWN_S, times, values)
        model = "LEFT.toml"
        whole = read_model(folder / "MODEL.toml", needs=("film", "plate"))
        assert whole.film is not None
        initial = "cooled" if run.left == "other branch" else whole.film.initial
        write_model(folder / model, replace(whole, film=replace(whole.film, initial=initial)))
    if run.exact:
        model = "EXACT.toml"
        write_model(folder / model, exact_model(film, SLOPED if run.sloped else NOMINAL))
    if run.wrong:
        found.errors[run.name] = wrong_error(film, run, folder, times, values)
        return ""
    if run.way == "resistance":
        rows = [f"{t:.3f},{10.0**y:.8g}" for t, y in zip(times, values, strict=True)]
        (folder / "target.csv").write_text("\n".join(["time_s,target_ohm", *rows]) + "\n")
    else:
        before_s = FROM_HOT_S
        write_temperatures(folder, run, times, values)
    bench = Bench(film, run, folder)
    text = bench.command("run", model, own_gains(film, run, model, folder) if run.tuned else "")
    if text:
        return f"{run.name}: {text} "
    errors = [error(bench.plants[-1], begin + before_s, times, values) for begin in bench.begin_s]
    found.errors[run.name], found.repetitions[run.name] = errors[-1], [rms for rms, _ in errors]
    return ""


def wrong_error(film: Film, run: Run, folder: Path, times: list[float], values: list[float]) -> tuple[float, float]:
    """RMS and largest error on the wrong plate, beside the plant: `_beside_the_plant` tells why."""
    model, plant = read_model(folder / "MODEL.toml", needs=("film", "plate")), plant_of(film, run, 0.0)
    assert model.film is not None
    assert model.plate is not None
    path = folder / "config.toml"
    path.write_text(configuration(film, run, "MODEL.toml"))
    law, _ = law_and_design("full", read_configuration(path).content, model.film, model.plate)
    state = placed(plant, law, model.film, values[0], HOT_DEGC)
    driven(plant, law, state, lambda t: np.interp(t - SETTLE_S, times, values), SETTLE_S + times[-1])
    return error(plant, SETTLE_S, times, values)


class Bench:
    """One command on the emulated instruments: the plants that were made, and when the target began (s)."""

    def __init__(self, film: Film, run: Run, folder: Path) -> None:
        self.film, self.which, self.folder = film, run, folder
        self.plants: list[TrackedPlant] = []
        self.begin_s: list[float] = []

    def command(self, verb: str, model: str, more: str = "") -> str:
        """What it said, where it failed."""
        from rig.__main__ import main

        film, run, said = self.film, self.which, io.StringIO()
        path = self.folder / "config.toml"
        path.write_text(configuration(film, run, model) + more)
        with (
            behind_the_instruments(lambda start_s: plant_of(film, run, start_s)) as self.plants,
            noted_phase(lambda name: name in ("track", "profile")) as self.begin_s,
            contextlib.redirect_stderr(said),
            contextlib.redirect_stdout(io.StringIO()),
        ):
            status = main([verb, str(path), "--out", str(self.folder / run.name)])
        return said.getvalue()[-300:] if status else ""


def configuration(film: Film, run: Run, model: str) -> str:
    """Its text: one setting for all rows, but for what the row is about."""
    law = run.law if run.way == "resistance" else "full"
    text = CONFIGURATION.format(current=film.current_A, model=model, law=law, low=COLD_DEGC, high=HOT_DEGC)
    text += f"[control]\nms = {run.ms}\n" if run.ms is not None else ""
    if run.way != "resistance":
        text = text.replace("track_resistance", "temperature_profile")
    if run.repeat > 1:
        text = text.replace("[experiment]\n", f"[experiment]\nrepeat = {run.repeat}\n")
    if run.memory:  # no pulse: the film stays where somebody has left it
        text = text.replace("[limits]\n", "[limits]\npolarity_share = 0.0\n")
        text = text.replace("[experiment]\n", f'[experiment]\nmemory = "{run.memory}"\n')
    return text


def own_gains(film: Film, run: Run, model: str, folder: Path) -> str:
    """The driver's options that `peltier tune` gives, as a table of the configuration."""
    from rig.__main__ import main

    path, told = folder / "tuned.toml", folder / "tuned.json"
    path.write_text(configuration(film, run, model))
    with contextlib.redirect_stdout(io.StringIO()):
        main(["tune", str(path), "--json", str(told)])
    gains = json.loads(told.read_text())["instrument_pid_gains"]["options"]
    return "[bench.controller.options]\n" + "".join(f"{key} = {value!r}\n" for key, value in gains.items())


def write_temperatures(folder: Path, run: Run, times: list[float], values: list[float]) -> None:
    """The target as temperatures, from the hot end: the paper's way, with its inverse offline; or looked up.

    Looked up: on the major loop's branch of the way that the resistance goes.
    """
    film = read_model(folder / "MODEL.toml", needs=("film", "plate")).film
    assert film is not None
    time = np.arange(0.0, times[-1], 0.1)
    wanted = -np.interp(time, times, values)
    hot = film.initial_memory(HOT_DEGC, "heated")
    if run.way == "inverse":
        degC, _ = Inverse(film, 10.0, 95.0).trajectory(wanted, hot)
    else:
        grid = np.arange(10.0, 95.0, 0.02)
        rising, _ = film.simulate(grid, film.initial_memory(10.0, "cooled"))
        falling, _ = film.simulate(grid[::-1], film.initial_memory(95.0, "heated"))
        up, down = np.interp(wanted, rising, grid), np.interp(wanted, falling[::-1], grid)
        moves = np.sign(np.diff(wanted, prepend=wanted[0]))
        known = np.maximum.accumulate(np.where(moves != 0.0, np.arange(moves.size), 0))
        degC = np.where(moves[known] > 0.0, up, down)
    good = np.isfinite(degC)
    degC = np.interp(time, time[good], degC[good])
    rows = [f"0,{HOT_DEGC}", f"5,{HOT_DEGC}", f"{0.6 * FROM_HOT_S},{degC[0]:.4f}"]
    rows += [f"{FROM_HOT_S + t:.2f},{v:.4f}" for t, v in zip(time, degC, strict=True)]
    (folder / "target.csv").write_text("\n".join(["time_s,setpoint_degC", *rows]) + "\n")


def error(plant: TrackedPlant, begin_s: float, times: list[float], values: list[float]) -> tuple[float, float]:
    """RMS and largest, in n, of the film itself over the target."""
    time, _, log_ohm = np.array(plant.course).T
    grid = np.arange(0.0, times[-1], 0.05)
    off = np.interp(begin_s + grid, time, log_ohm) - np.interp(grid, times, values)
    return float(np.sqrt(np.mean(off**2))) / NOISE_DEC, float(np.max(np.abs(off))) / NOISE_DEC
