"""Which records told the film of a model: written with it, and read again where a run of that model is diagnosed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compensator.hysteresis.film import IDENTITY, FilmModel, Memoryless
from rig.analysis.film_records import earlier_film_records
from rig.config.model_file import Model, read_model, write_model
from rig.records.record_file import write_columns
from rig.records.run_folder import final_path

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


def test_a_model_file_keeps_them(run: Path) -> None:
    model = read_model(run.parent / "model.toml")
    assert [Path(name).parent.name for name in model.film_records] == ["cal", "gone", "run"]


def test_a_calibration_inside_a_run_is_named_as_it_will_be_called(tmp_path: Path) -> None:
    inside = tmp_path / "run.part" / "calibration" / "record.csv"
    assert final_path(inside) == tmp_path / "run" / "calibration" / "record.csv"
