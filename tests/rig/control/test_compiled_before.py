"""Nothing compiles in mid experiment, and a pause of the program's own is no defect of its record."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rig.experiment.calibration import own_pauses, through_pauses
from sim.inference.film.rows import FilmRecord, prepare
from tests.rig.small import write_bench

# What is looked up in the cache of compiled loops after the first pulse would be compiled there, if it were empty.
WATCHED = """
import sys
import compensator.compiled as compiled
from rig.control.loop import Loop
from rig.drivers.meerstetter import MeerstetterController
from rig.__main__ import main

on, late = [], []
look_up, send = compiled._Cache.load_overload, MeerstetterController.set_current_A

def looked_up(cache, signature, context):
    if on:
        late.append(str(cache._loop))
    return look_up(cache, signature, context)

def sent(controller, current_A, *more, **others):
    if current_A != 0.0:
        on.append(current_A)
    return send(controller, current_A, *more, **others)

compiled._Cache.load_overload, MeerstetterController.set_current_A = looked_up, sent
status = main(sys.argv[1:])
print("late:", late, "pulses:", bool(on))
sys.exit(status)
"""
CALIBRATION = """
[calibration]
temperature_degC = [40, 85]
rate_K_per_s = 1.5
minor_loops = 2
"""


@pytest.mark.parametrize(
    "changes",
    [
        (('model = "model.toml"\ntarget', "target"),),  # calibrates before
        (("period_s = 0.1", 'period_s = 0.1\ncompare = ["pid", "feedforward"]'),),
        (
            ('kind = "track_resistance"', 'kind = "temperature_profile"'),
            ('"start 20 kohm", "hold 5 s", "ramp to 5 kohm at 0.1 dec/s"', '"start 60 degC", "hold 5 s"'),
        ),
    ],
)
def test_no_loop_is_compiled_after_a_pulse(root: Path, tmp_path: Path, changes: tuple[tuple[str, str], ...]) -> None:
    """With an empty cache a calibration stood still for three minutes between its pulses and its profile."""
    path = write_bench(tmp_path, more=CALIBRATION)
    for before, after in changes:
        assert before in path.read_text()
        path.write_text(path.read_text().replace(before, after, 1))
    command = [sys.executable, "-c", WATCHED, "run", str(path), "--out", str(tmp_path / "out")]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "late: [] pulses: True", done.stdout
    assert "gap" not in done.stdout


def test_a_pause_of_the_programs_own_is_no_gap() -> None:
    """On a slow computer a fit between two phases takes seconds: the plate is without a current meanwhile, and the
    film's memory is known."""
    time_s = np.concatenate((np.arange(0.0, 60.0, 0.25), np.arange(80.0, 140.0, 0.25)))
    degC = 40.0 + 20.0 * np.exp(-time_s / 40.0) + 15.0 * np.sin(time_s / 9.0) * (time_s > 80.0)
    output, current_A, tick = -4.0 - 0.01 * degC, np.zeros(time_s.size), np.ones(time_s.size)
    tick[[0, 240]] = 0
    everywhere = np.ones(time_s.size, dtype=np.bool_)
    own = own_pauses(time_s, current_A, tick, everywhere)
    assert own.tolist() == [240]
    filled = through_pauses(own, time_s, degC, output, time_s)
    assert prepare(FilmRecord(time_s, degC, output)).unseen.size == 1
    assert prepare(FilmRecord(*filled[:3], output_time_s=filled[3])).gaps.size == 0
    assert np.count_nonzero(np.isfinite(filled[2])) == time_s.size  # no reading is made up
    current_A[239] = 0.5
    assert own_pauses(time_s, current_A, tick, everywhere).size == 0  # who knows where that current took it
    tick[240] = math.nan
    assert own_pauses(time_s, 0.0 * current_A, tick, everywhere).size == 0  # within a phase rows are missing
