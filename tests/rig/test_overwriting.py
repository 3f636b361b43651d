"""No verb writes over what it reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.peltier import Peltier
from tests.rig.small import write_bench

RECORD = "time_s,temperature_degC,resistance_ohm\n" + "".join(f"{k},{40 + k},{20000 - 50 * k}\n" for k in range(20))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder: a bench, a record and a link to it, and a run's folder with a file of somebody's own."""
    monkeypatch.chdir(tmp_path)
    write_bench(tmp_path)
    (tmp_path / "record.csv").write_text(RECORD)
    (tmp_path / "link.csv").symlink_to("record.csv")
    for folder in ("new", "film_a"):
        (tmp_path / folder).mkdir()
    for name in ("run.json", "record.csv", "MODEL.toml", "report.html", "mine.csv"):
        (tmp_path / "film_a" / name).write_text("two hours of measuring")
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("identify", "record.csv", "--out", "record.csv"), "--out"),
        (("identify", "record.csv", "--out", "./new/../record.csv"), "--out"),
        (("predict", "model.toml", "record.csv", "--out", "model.toml"), "--out"),
        (("predict", "model.toml", "record.csv", "--json", "record.csv"), "--json"),
        (("invert", "model.toml", "record.csv", "--out", "link.csv"), "--out"),
        (("simulate", "config.toml", "--out", "config.toml"), "--out"),
    ],
)
def test_what_is_read_is_not_written(peltier: Peltier, here: Path, words: tuple[str, ...], option: str) -> None:
    before = contents(here)
    status, _, err = peltier(*words)
    assert (status, len(err.splitlines())) == (2, 1)
    assert f"{option}: is what is read; expected another file" in err
    assert contents(here) == before


def test_two_outputs_in_one_file_are_refused(peltier: Peltier, here: Path) -> None:
    status, _, err = peltier("predict", "model.toml", "record.csv", "--out", "p", "--json", "p")
    assert (status, err) == (2, "p: --out and --json: the same file; expected two\n")
    assert not (here / "p").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("simulate", "config.toml", "--out", "film_a/record.csv"), "--out: belongs to the run in film_a"),
        (("identify", "record.csv", "--out", "film_a/MODEL.toml"), "--out: belongs to the run in film_a"),
        (("predict", "model.toml", "record.csv", "--json", "film_a/run.json"), "--json: belongs to the run in film_a"),
        (("identify", "record.csv", "--report", "film_a"), "film_a: --report: is a run's folder"),
    ],
)
def test_what_a_run_has_written_stays(peltier: Peltier, here: Path, words: tuple[str, ...], said: str) -> None:
    before = contents(here)
    status, _, err = peltier(*words)
    assert (status, len(err.splitlines())) == (2, 1)
    assert said in err
    assert contents(here) == before


def test_a_file_beside_a_run_may_be_replaced(peltier: Peltier, here: Path) -> None:
    peltier.succeeds("predict", "model.toml", "record.csv", "--out", "film_a/mine.csv")
    assert "predicted_ohm" in (here / "film_a" / "mine.csv").read_text()
