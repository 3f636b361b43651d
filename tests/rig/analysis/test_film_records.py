"""The records that a film was fitted to: they are read again where a run of its model is diagnosed, and beyond their
temperatures a model is a guess."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compensator.hysteresis.film import IDENTITY, FilmModel, Memoryless
from rig.analysis.film_records import earlier_film_records
from rig.config.model_file import Model, read_model, write_model
from rig.records.record_file import write_columns
from tests.peltier import Peltier
from tests.rig.small import MODEL

SEEN = "film_seen_degC = [45.0, 80.0]\n"
LINE = "film_seen_degC: 2 temperatures lie beyond 45.0 to 80.0 degC, where the film was measured; the furthest is 9"
FILM = FilmModel(np.array([1.0]), np.array([0.1]), IDENTITY, IDENTITY, Memoryless("none"), "classical_pi")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run's record, whose model was told by two records, of which one is gone; both in folders of their own."""
    for name in ("cal", "run"):
        (tmp_path / name).mkdir()
        write_columns(tmp_path / name / "record.csv", {"time_s": np.arange(50.0), "temperature_degC": np.arange(50.0)})
    told_by = tuple(str(tmp_path / name / "record.csv") for name in ("cal", "gone", "run"))
    write_model(tmp_path / "run" / "model.toml", Model(FILM, None, film_records=told_by))
    (tmp_path / "run" / "run.json").write_text("{}")
    return tmp_path / "run" / "record.csv"


def test_those_that_can_be_read_are_taken_and_the_others_told(run: Path) -> None:
    said: list[str] = []
    found = earlier_film_records(str(run), said.append)
    assert [record.source for record in found] == [str(run.parent.parent / "cal" / "record.csv")]
    assert len(said) == 2
    assert "cal/record.csv" in said[0]
    assert "gone/record.csv" in said[1]


def test_a_record_that_is_of_no_run_has_none(run: Path) -> None:
    (run.parent / "run.json").unlink()
    assert earlier_film_records(str(run)) == []


def test_a_model_that_cannot_be_read_is_told(run: Path) -> None:
    (run.parent / "model.toml").write_text("film = 1\n")
    said: list[str] = []
    assert earlier_film_records(str(run), said.append) == []
    assert "model.toml" in said[0]


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


def test_an_inversion_beyond_what_was_seen_is_told(model: Path, tmp_path: Path, peltier: Peltier) -> None:
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


def test_a_prediction_beyond_what_was_seen_is_told(model: Path, tmp_path: Path, peltier: Peltier) -> None:
    record = tmp_path / "record.csv"
    record.write_text("time_s,temperature_degC,resistance_ohm\n0,50,90000\n1,80.9,500\n2,93,400\n3,,400\n4,40,1e5\n")
    status, _, err = peltier("predict", model, record)
    assert status == 0
    assert LINE in err


def test_identify_writes_what_it_has_seen(tmp_path: Path, peltier: Peltier) -> None:
    up = np.concatenate((np.linspace(40.0, 84.0, 120), np.linspace(84.0, 41.0, 120)))
    (tmp_path / "true.toml").write_text(MODEL)
    film = read_model(tmp_path / "true.toml").film
    assert film is not None
    ohm = 10.0 ** -film.simulate(up, film.initial_memory(40.0, "heated"))[0]
    rows = "".join(f"{k},{degC!r},{r!r}\n" for k, (degC, r) in enumerate(zip(up.tolist(), ohm.tolist(), strict=True)))
    (tmp_path / "record.csv").write_text("time_s,temperature_degC,resistance_ohm\n" + rows)
    peltier.succeeds("identify", tmp_path / "record.csv", "--out", tmp_path / "model.toml")
    assert read_model(tmp_path / "model.toml").film_seen_degC == (40.0, 84.0)
