"""A plate that more than its current heats, where the record has what: a logged room, a second drive."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

S, R, G, SECOND_K_PER_S = 1.67e-3, 0.067, 0.0167, 0.12
ROWS, PERIOD_S, PARTS, NOISE_K = 1600, 0.5, 10, 0.01
PLAIN = ("time_s", "temperature_degC", "current_A")


def truth(seed: int, room_degC: float) -> dict[str, np.ndarray]:
    """Columns of a record: a room that goes up and down by 3 K, logged 1.5 K too cold, and a second heater."""
    chance, time = np.random.default_rng(seed), PERIOD_S * np.arange(ROWS)
    current = np.repeat(chance.uniform(-2.0, 3.0, ROWS // 60 + 1), 60)[:ROWS]
    second = np.repeat(chance.uniform(0.0, 1.0, ROWS // 150 + 1), 150)[:ROWS]
    room = room_degC + 3.0 * np.sin(2.0 * np.pi * time / 600.0)
    plate, shown = room_degC, np.empty(ROWS)
    for k in range(ROWS):
        shown[k] = plate
        for j in range(PARTS):
            here = room[k] + (room[min(k + 1, ROWS - 1)] - room[k]) * (j + 0.5) / PARTS
            driven = S * current[k] * (plate + 273.15) + 0.5 * R * current[k] ** 2 + SECOND_K_PER_S * second[k]
            plate += PERIOD_S / PARTS * (driven - G * (plate - here))
    shown += NOISE_K * chance.standard_normal(ROWS)
    return {
        "time_s": time, "temperature_degC": shown, "current_A": current, "ambient_degC": room - 1.5, "input_2": second
    }  # fmt: skip


def written(path: Path, columns: dict[str, np.ndarray], names: tuple[str, ...] = ()) -> Path:
    names = names or tuple(columns)
    np.savetxt(path, np.column_stack([columns[n] for n in names]), "%.17g", ",", header=",".join(names), comments="")
    return path


@pytest.fixture(scope="module")
def records() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    return truth(1, 22.0), truth(2, 25.0)


Call = Callable[..., tuple[int, str, str]]
Records = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]


def test_what_else_heats_the_plate_is_taken_into_account(records: Records, tmp_path: Path, peltier: Call) -> None:
    one, other = (written(tmp_path / f"{k}.csv", columns) for k, columns in enumerate(records))
    model = tmp_path / "model.toml"
    status, out, _ = peltier("diagnose", one, "--holdout", other, "--out", model, "--json", "-")
    found = json.loads(out)
    assert (status, found["verdict"]) == (0, "clean")
    assert found["channels"]["temperature_K"]["rmse_extended"] < 1.2 * NOISE_K
    plate = {name: each["value"] for name, each in found["plate"]["parameters"].items()}
    assert plate["inputs.input_2"] == pytest.approx(SECOND_K_PER_S, rel=0.01)
    assert plate["inputs.ambient_degC"] == pytest.approx(G, rel=0.01)
    assert plate["ambient_degC"] == pytest.approx(22.0, abs=0.1)
    status, out, _ = peltier("predict", model, other, "--initial", "fitted", "--json", "-")
    said = found["channels"]["temperature_K"]["rmse_extended"]
    assert (status, json.loads(out)["rmse_K"]) == (0, pytest.approx(said, rel=0.05))
    without = written(tmp_path / "without.csv", records[1], (*PLAIN, "ambient_degC"))
    for words in (("predict", model, without), ("diagnose", one, "--holdout", without)):
        status, _, told = peltier(*words)
        assert status == 2
        assert "input_2: missing" in told


def test_without_them_something_is_left(records: Records, tmp_path: Path, peltier: Call) -> None:
    """Or the test above would say nothing."""
    one, other = (written(tmp_path / f"{k}.csv", columns, PLAIN) for k, columns in enumerate(records))
    found = json.loads(peltier("diagnose", one, "--holdout", other, "--json", "-")[1])
    assert found["channels"]["temperature_K"]["rmse_extended"] > 20.0 * NOISE_K
    assert found["unexplained"]["temperature_K"] is not None
