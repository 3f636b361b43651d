"""Temperatures at which nobody has measured a film are told, by who asks a model about them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import rig
from rig.config.model_file import read_model
from tests.rig.small import MODEL

Peltier = Callable[..., tuple[int, str, str]]
SEEN = "film_seen_degC = [45.0, 80.0]\n"
LINE = "film_seen_degC: 2 temperatures lie beyond 45.0 to 80.0 degC, where the film was measured, up to 9"


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "model.toml"
    path.write_text(SEEN + MODEL)
    return path


def ohm_at(model: Path, *temperatures_degC: float) -> list[float]:
    """On the way up from the cold."""
    film = read_model(model).film
    assert film is not None
    outputs, _ = film.simulate(np.array([30.0, *temperatures_degC]), film.initial_memory(30.0, "heated"))
    return [10.0 ** -float(u) for u in outputs[1:]]


def test_invert(model: Path, tmp_path: Path, peltier: Peltier) -> None:
    target = tmp_path / "target.csv"
    resistances = ohm_at(model, 60.0, 85.0, 95.0, 96.0)
    target.write_text("time_s,target_ohm\n" + "".join(f"{k},{ohm!r}\n" for k, ohm in enumerate(resistances)))
    words = ("invert", model, target, "--out", tmp_path / "out.csv", "--initial", "heated")
    status, _, err = peltier(*words)
    assert status == 0
    assert LINE.replace("2 temp", "3 temp") in err
    assert peltier(*words, "--limits", "20,80.5")[2] == ""
    model.write_text(MODEL)
    assert peltier(*words)[2] == ""


def test_predict(model: Path, tmp_path: Path, peltier: Peltier) -> None:
    record = tmp_path / "record.csv"
    record.write_text("time_s,temperature_degC,resistance_ohm\n0,50,90000\n1,80.9,500\n2,93,400\n3,,400\n4,40,1e5\n")
    status, _, err = peltier("predict", model, record)
    assert status == 0
    assert LINE in err


def test_in_python(model: Path) -> None:
    inside, beyond = ohm_at(model, 60.0, 95.0)
    with pytest.warns(UserWarning, match="1 temperature lies beyond 45.0 to 80.0 degC"):
        rig.invert(model, [inside, beyond], initial="heated")


def test_identify_writes_what_it_has_seen(tmp_path: Path, peltier: Peltier) -> None:
    up = np.concatenate((np.linspace(40.0, 84.0, 120), np.linspace(84.0, 41.0, 120)))
    (tmp_path / "true.toml").write_text(MODEL)
    film = read_model(tmp_path / "true.toml").film
    assert film is not None
    ohm = 10.0 ** -film.simulate(up, film.initial_memory(40.0, "heated"))[0]
    rows = "".join(f"{k},{degC!r},{r!r}\n" for k, (degC, r) in enumerate(zip(up.tolist(), ohm.tolist(), strict=True)))
    (tmp_path / "record.csv").write_text("time_s,temperature_degC,resistance_ohm\n" + rows)
    status, _, err = peltier("identify", tmp_path / "record.csv", "--out", tmp_path / "model.toml")
    assert status == 0, err
    assert read_model(tmp_path / "model.toml").film_seen_degC == (40.0, 84.0)
