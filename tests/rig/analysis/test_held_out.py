"""Another day, another room: what belongs to a record is fitted to its first rows, by `diagnose` and `predict`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.analysis.diagnosed import require_judging
from rig.records.record import Record
from rig.records.record_file import write_columns
from sim.world.plant import World, simulate_record
from tests.peltier import Peltier
from tests.sim.small_chain import FILM, PLATE, on

TIME = np.arange(0.0, 600.0, 0.5)
NOISE_K = 0.01
WARMER_K = 4.0  # the room on the other day
TOLD = 61  # rows of 30 s


def record(path: Path, seed: int, room_degC: float, first_degC: float, period_s: float) -> Path:
    """A plate with a lagging thermometer, driven to and fro."""
    current = 0.9 + 0.8 * np.sign(np.sin(TIME / period_s)) + 0.3 * np.sin(TIME / 23.0)
    plate = replace(PLATE, ambient_degC=room_degC)
    world = World(plate, FILM, first_degC, thermometer_noise_K=NOISE_K, seed=seed, effects=(on("sensor_lag"),))
    shown = simulate_record(world, TIME, current)
    write_columns(path, {"time_s": TIME, "temperature_degC": shown.temperature_degC, "current_A": current})
    return path


def test_the_error_said_is_the_error_got(tmp_path: Path, peltier: Peltier) -> None:
    """Each held-out record has a room of its own; the error said is that over the rows of all."""
    record(tmp_path / "one.csv", 1, 25.0, 50.0, 17.0)
    warm, cold = (
        record(tmp_path / "warm.csv", 2, 25.0 + WARMER_K, 62.0, 29.0),
        record(tmp_path / "cold.csv", 3, 19.0, 45.0, 23.0),
    )
    words = ("--holdout", warm, "--holdout", cold, "--out", tmp_path / "model.toml", "--json", "-")
    out = peltier.succeeds("diagnose", tmp_path / "one.csv", *words)
    said = json.loads(out)
    assert [e["name"] for e in said["effects"]] == ["sensor_lag"]
    channel = said["channels"]["temperature_K"]
    assert channel["samples_holdout"] == 2 * (TIME.size - TOLD)
    assert channel["rmse_base"] > 3.0 * channel["rmse_extended"]
    assert 'drive = "current"' in (tmp_path / "model.toml").read_text()

    def predicted(path: Path, *words: str) -> dict[str, Any]:
        out = peltier.succeeds("predict", tmp_path / "model.toml", path, *words, "--json", "-")
        return dict(json.loads(out))

    fitted = [predicted(path, "--initial", "fitted") for path in (warm, cold)]
    assert np.mean([got["rmse_K"] ** 2 for got in fitted]) ** 0.5 == pytest.approx(channel["rmse_extended"], rel=1e-9)
    for got, room in zip(fitted, (25.0 + WARMER_K, 19.0), strict=True):
        assert got["rows_K"] == TIME.size - TOLD
        assert got["rmse_K"] < 2.0 * NOISE_K
        assert got["fitted"]["ambient_degC"] == pytest.approx(room, abs=0.5)
        assert "notes" not in got
    as_it_is = predicted(warm)
    assert as_it_is["rmse_K"] > 1.0  # in the room of the day before
    (note,) = as_it_is["notes"]
    assert "room temperature taken from the model, 2" in note
    assert "--initial fitted" in note
    assert predicted(warm, "--initial", "fitted", "--first", "120")["rows_K"] == TIME.size - 241


MOVING, ONES = 25.0 + 0.05 * TIME, np.ones(TIME.size)
SWITCHING = 1e4 * 10.0 ** np.sin(TIME / 50.0)
BASES = {  # of a diagnosed record
    "plate": {"temperature_degC": MOVING, "current_A": np.sin(TIME / 9.0)},
    "film": {"temperature_degC": MOVING, "resistance_ohm": SWITCHING},
}


@pytest.mark.parametrize(
    ("base", "columns", "said"),
    [
        ("plate", {}, "current_A: missing; expected a current that drives the plate"),
        ("plate", {"resistance_ohm": 1e3 * ONES}, "current_A: missing; expected a current"),
        ("plate", {"resistance_ohm": SWITCHING}, "current_A: missing; expected a current"),
        ("plate", {"current_A": 0.0 * ONES}, "current_A: 0 in all rows; expected a current"),
        ("plate", {"temperature_degC": 25.0 * ONES, "current_A": ONES}, "moves by 0 K only"),
        ("plate", {"temperature_degC": np.where(TIME < 15.0, MOVING, np.nan), "current_A": ONES}, "30 finite readings"),
        ("film", {"current_A": ONES}, "resistance_ohm: missing; expected a film that switches"),
        ("film", {"resistance_ohm": 1e3 * ONES}, "resistance_ohm: changes by 0 decades only"),
    ],
)
def test_a_record_that_cannot_judge_is_refused_before_the_search(
    base: str, columns: dict[str, np.ndarray], said: str, tmp_path: Path, peltier: Peltier
) -> None:
    one, good, other = (tmp_path / f"{name}.csv" for name in ("one", "good", "other"))
    write_columns(one, {"time_s": TIME, **BASES[base]})
    write_columns(good, {"time_s": TIME, **BASES[base], "temperature_degC": MOVING + 1.0})
    write_columns(other, {"time_s": TIME, "temperature_degC": MOVING, **columns})
    words = ("--holdout", good, "--holdout", other, "--report", tmp_path / "report")
    status, out, err = peltier("diagnose", one, *words)
    assert (status, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith(f"{other}: ")
    assert said in line
    assert not (tmp_path / "report").exists()


def test_a_record_without_current_judges_the_film_alone_and_it_is_said() -> None:
    whole = Record({"time_s": TIME, **BASES["plate"], **BASES["film"]}, "whole")
    film, said = Record({"time_s": TIME, **BASES["film"]}, "film"), list[str]()
    require_judging([film], [whole], [whole.columns], "minus_log10_ohm", said.append)
    assert said == ["film: no current_A: it judges the film alone"]


def test_a_record_is_given_once(tmp_path: Path, peltier: Peltier) -> None:
    """Held out it would judge the fit to itself, also under another name; joined it would count twice."""
    one, copy, good = (tmp_path / f"{name}.csv" for name in ("one", "copy", "good"))
    for path, warmer in ((one, 0.0), (copy, 0.0), (good, 1.0)):
        write_columns(path, {"time_s": TIME, **BASES["plate"], "temperature_degC": MOVING + warmer})
    twice, held = f"{one}: is given twice; expected", ("--holdout", good)
    for words, said in (
        ((one, "--holdout", one), twice),
        ((one, one, "--joint"), twice),
        ((one, *held, *held), f"{good}: is given twice; expected"),
        ((one, *held, "--holdout", copy), f"{copy}: holds the same as {one}; expected"),
    ):
        err = peltier.fails("diagnose", *words)
        (line,) = err.splitlines()
        assert line.startswith(said)
