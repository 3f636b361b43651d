"""A simulated bench on plants of `tests/truth.py`: commands on it, and a law beside it without bench and interlock.

Plate, films, target and noise are those that the control benchmarks share. Beside the plant a law has the emulated
instruments' moments: thermometer and command come 4 and 14 ms after each tick; the ohmmeter integrates twice before the
next, and its reading is the mean of both (`rig.control.meter_readings`). What a rig that is wrong by a fifth does to a
law can only be seen so: a run on it is ended, rightly, by the watch over the plate.
"""

from __future__ import annotations

import contextlib
import io
import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from compensator.control.law import Law
from compensator.control.law_step import Inputs, LawState
from compensator.hysteresis.film import FilmModel
from compensator.inverse.inverse import Inverse
from rig.config.model_file import Model, read_model
from tests.truth import NOISE_DEC, Film, Plant, Plate

HOT_DEGC, COLD_DEGC = 85.0, 35.0  # of a calibration
NOMINAL = Plate()
WRONG = Plate(seebeck=0.04, resistance=2.4, conductance=0.6, ambient_degC=30.0)  # S -20 %, R_e, G +20 %, room +5 K
WRONG_LAG = {"sensor_lag": {"tau_s": 2.0}}  # hidden with the wrong plate
RATE_DEC_PER_S, DWELL_S, LEVELS, SINE_DEC, SINE_S = 0.01, 30.0, 6, 0.8, 300.0  # of a target
PERIOD_S, THERMOMETER_S, COMMAND_S = 0.1, 0.0044, 0.0143
OHMMETER_S = 0.0485, 0.0725  # the middles of its integrations
AGES_S = PERIOD_S + THERMOMETER_S - sum(OHMMETER_S) / len(OHMMETER_S), COMMAND_S - THERMOMETER_S
SETTLE_S = 30.0  # beside the plant, before the target begins

SIMULATED_BENCH = """
[bench]
time = "virtual"
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
"""
CONFIGURATION = (
    SIMULATED_BENCH
    + f"""
[limits]
temperature_degC = [10, 95]
current_A = 4.0
meter_current_A = 1e-4
[experiment]
kind = "track_resistance"
target = "target.csv"
model = "{{model}}"
law = "{{law}}"
period_s = 0.1
[calibration]
temperature_degC = [{COLD_DEGC}, {HOT_DEGC}]
rate_K_per_s = 0.7
minor_loops = 8
dwell_s = 2.0
"""
)


@dataclass
class Ended:
    """A command that has ended: exit status, what it said, its plants, when the asked phase began (s)."""

    status: int = 0
    said: str = ""
    plants: list[Any] = field(default_factory=list)
    begin_s: list[float] = field(default_factory=list)


def command(
    words: Sequence[object],
    made: Callable[[float], Any] | None = None,
    is_phase: Callable[[str], bool] = lambda name: name == "track",
    ended: Ended | None = None,
) -> Ended:
    """Run a verb in this process. made: makes a plant for the first moment (s) of each simulated bench; without it they
    are the program's own. ended: is filled while it runs."""
    import rig.bench.assembly
    from rig.__main__ import main

    ended, said = ended or Ended(), io.StringIO()

    def world(_: Any, start_s: float) -> Any:
        ended.plants.append(made(start_s))
        return ended.plants[-1]

    before = rig.bench.assembly.SimulatedPlant
    if made is not None:
        rig.bench.assembly.SimulatedPlant = world  # type: ignore[assignment,misc]
    try:
        with (
            _noted_phase(is_phase, ended.begin_s),
            contextlib.redirect_stderr(said),
            contextlib.redirect_stdout(io.StringIO()),
        ):
            ended.status = main([str(word) for word in words])
    except SystemExit as end:
        ended.status = int(end.code or 0)
    finally:
        rig.bench.assembly.SimulatedPlant = before  # type: ignore[misc]
    ended.said = said.getvalue()[-300:]
    return ended


@contextlib.contextmanager
def _noted_phase(is_it: Callable[[str], bool], begin_s: list[float]) -> Iterator[None]:
    """Note when the phases began whose name is the one asked for, by the loop's clock: a plant is behind it, for it is
    moved when somebody asks for it."""
    from rig.control.loop import Loop

    whole = Loop._phase

    def noting(self: Loop, name: str, *rest: Any) -> None:
        if is_it(name):
            begin_s.append(self.bench.clock.now_s())
        whole(self, name, *rest)

    Loop._phase = noting  # type: ignore[method-assign]
    try:
        yield
    finally:
        Loop._phase = whole  # type: ignore[method-assign]


def calibrated(folder: Path, film: Film, seed: int) -> Model:
    """Return what `calibrate` makes of a film on the nominal plate; config.toml is that of a run with it."""
    write_target(folder, [0.0, 1.0], [4.0, 4.0])
    (folder / "config.toml").write_text(CONFIGURATION.format(model="target.csv", law="full"))
    words = ["calibrate", folder / "config.toml", "--out", folder / "cal"]
    ended = command(words, lambda start_s: Plant(NOMINAL, film, seed, start_s))
    if ended.status:
        raise RuntimeError(f"calibrate: {ended.said}")
    (folder / "config.toml").write_text(CONFIGURATION.format(model="cal/MODEL.toml", law="full"))
    return read_model(folder / "cal" / "MODEL.toml", needs=("film", "plate"))


def write_target(folder: Path, times: Sequence[float], values: Sequence[float]) -> None:
    """Write log10 R at times (s) as the target."""
    rows = [f"{t:.3f},{10.0**y:.8g}" for t, y in zip(times, values, strict=True)]
    (folder / "target.csv").write_text("\n".join(["time_s,target_ohm", *rows]) + "\n")


def middle_of(film: Film) -> tuple[float, float]:
    """Return the middle 80 % of the film's range of log10 R over a calibration's temperatures, on its major loop."""
    degC = np.arange(COLD_DEGC, HOT_DEGC, 0.1)
    y = -np.concatenate((film.branch(degC, True), film.branch(degC, False)))
    low, high = float(y.min()), float(y.max())
    return low + 0.1 * (high - low), high - 0.1 * (high - low)


def course(film: Film, seed: int, first: float | None = None) -> tuple[list[float], list[float]]:
    """Return times and wanted log10 R within the middle of a film's range: ramps between random levels, dwells, and a
    sine; first: where it begins."""
    chance, (low, high) = random.Random(seed), middle_of(film)
    times, values = [0.0, 10.0], [high - 0.3 * (high - low) if first is None else first] * 2

    def to(value: float) -> None:
        times.append(times[-1] + abs(value - values[-1]) / RATE_DEC_PER_S + 1.0)
        times.append(times[-1] + DWELL_S)
        values.extend([value, value])

    for _ in range(LEVELS):
        to(chance.uniform(low, high))
    middle = 0.5 * (low + high)
    to(middle)
    begin = times[-1]
    for k in range(1, 601):
        times.append(begin + k * SINE_S / 600)
        values.append(middle + 0.5 * SINE_DEC * math.sin(2.0 * math.pi * k / 600))
    return times, values


def error(plant: Plant, begin_s: float, times: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Return RMS and largest, in n = `NOISE_DEC`, of the film itself over the target."""
    time, _, log_ohm = np.array(plant.course).T
    grid = np.arange(0.0, times[-1], 0.05)
    off = np.interp(begin_s + grid, time, log_ohm) - np.interp(grid, times, values)
    return float(np.sqrt(np.mean(off**2))) / NOISE_DEC, float(np.max(np.abs(off))) / NOISE_DEC


def placed(plant: Plant, law: Law, film: FilmModel, log_ohm: float) -> LawState:
    """Put film and plate where the model has that resistance on the way down from the hot end, and the law there."""
    hot = film.initial_memory(HOT_DEGC, "heated")
    first_degC = Inverse(film, 10.0, 95.0).solve(-log_ohm, hot).temperature_degC
    for degC in (*np.arange(25.0, HOT_DEGC, 0.1), *np.arange(HOT_DEGC, first_degC, -0.02)):
        plant.log_ohm = plant.film.log_ohm(float(degC))
    plant.degC = plant.shown_degC = plant.lagged_degC = first_degC
    return law.start(first_degC, film.step(first_degC, hot)[1])


def driven(plant: Plant, law: Law, state: LawState, wanted: Callable[[Any], Any], duration_s: float) -> None:
    """Run the law on the plant; wanted: log10 R at times (s)."""
    ahead_s, output = law.preview_times_s(), math.nan
    for k in range(round(duration_s / PERIOD_S)):
        tick_s = k * PERIOD_S
        plant.advance_to(tick_s + THERMOMETER_S)
        reading = plant.read_temperature_degC()
        now, coming = -float(wanted(tick_s + THERMOMETER_S)), -np.asarray(wanted(tick_s + COMMAND_S + ahead_s))
        command, state = law.step(state, Inputs(reading, output, now, coming, *AGES_S))
        plant.advance_to(tick_s + COMMAND_S)
        plant.set_current_A(command.current_A)
        ohms = []
        for ohmmeter_s in OHMMETER_S:
            plant.advance_to(tick_s + ohmmeter_s)
            ohms.append(plant.read_resistance_ohm(0.0))
        output = -math.log10(sum(ohms) / len(ohms))
