"""Another day, another room: what belongs to a record is fitted to its first rows, by `diagnose` and `predict`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig.files.record_file import write_columns
from sim.world.open_loop import simulate_record
from sim.world.world import World
from tests.sim.small_chain import FILM, PLATE, on

Peltier = Callable[..., tuple[int, str, str]]
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


@pytest.fixture
def said(tmp_path: Path, peltier: Peltier) -> dict[str, object]:
    """A diagnosis with another day's record held out."""
    record(tmp_path / "one.csv", 1, 25.0, 50.0, 17.0)
    record(tmp_path / "other.csv", 2, 25.0 + WARMER_K, 62.0, 29.0)
    words = ("--holdout", tmp_path / "other.csv", "--out", tmp_path / "model.toml", "--json", "-")
    status, out, err = peltier("diagnose", tmp_path / "one.csv", *words)
    assert status == 0, err
    return dict(json.loads(out))


def test_the_error_said_is_the_error_got(tmp_path: Path, peltier: Peltier, said: dict[str, object]) -> None:
    assert [e["name"] for e in said["effects"]] == ["sensor_lag"]  # type: ignore[attr-defined]
    channel = said["channels"]["temperature_K"]  # type: ignore[index]

    def predicted(*words: str) -> dict[str, object]:
        status, out, err = peltier("predict", tmp_path / "model.toml", tmp_path / "other.csv", *words, "--json", "-")
        assert status == 0, err
        return dict(json.loads(out))

    got = predicted("--initial", "fitted")
    assert got["rmse_K"] == pytest.approx(channel["rmse_extended"], rel=1e-9)
    assert got["rows_K"] == channel["samples_holdout"] == TIME.size - TOLD
    assert got["rmse_K"] < 2.0 * NOISE_K  # type: ignore[operator]
    fitted = got["fitted"]
    assert fitted["ambient_degC"] == pytest.approx(25.0 + WARMER_K, abs=0.3)  # type: ignore[index]
    assert predicted()["rmse_K"] > 1.0  # type: ignore[operator]  # in the room of the day before
    longer = predicted("--initial", "fitted", "--first", "120")
    assert longer["rows_K"] == TIME.size - 241
    assert 'drive = "current"' in (tmp_path / "model.toml").read_text()


def test_several_records_are_held_out_as_one(tmp_path: Path, peltier: Peltier) -> None:
    """Each with a room of its own; the error said is that over the rows of all."""
    record(tmp_path / "one.csv", 1, 25.0, 50.0, 17.0)
    others = [record(tmp_path / "warm.csv", 2, 29.0, 62.0, 29.0), record(tmp_path / "cold.csv", 3, 19.0, 45.0, 23.0)]
    words = [word for path in others for word in ("--holdout", path)]
    status, out, err = peltier(
        "diagnose", tmp_path / "one.csv", *words, "--out", tmp_path / "model.toml", "--json", "-"
    )
    assert status == 0, err
    said = json.loads(out)
    assert [e["name"] for e in said["effects"]] == ["sensor_lag"]
    channel = said["channels"]["temperature_K"]
    assert channel["samples_holdout"] == 2 * (TIME.size - TOLD)
    square, rooms = 0.0, []
    for path in others:
        status, out, err = peltier("predict", tmp_path / "model.toml", path, "--initial", "fitted", "--json", "-")
        assert status == 0, err
        got = json.loads(out)
        square += got["rmse_K"] ** 2 / 2.0
        rooms.append(got["fitted"]["ambient_degC"])
    assert square**0.5 == pytest.approx(channel["rmse_extended"], rel=1e-9)
    assert channel["rmse_base"] > 3.0 * channel["rmse_extended"]
    assert rooms == pytest.approx([29.0, 19.0], abs=0.5)
