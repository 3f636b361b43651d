"""No verb writes over what it reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench

RECORD = "time_s,temperature_degC,resistance_ohm\n" + "".join(f"{k},{40 + k},{20000 - 50 * k}\n" for k in range(20))


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
def test_what_is_read_is_not_written(
    peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], option: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_bench(tmp_path)
    (tmp_path / "new").mkdir()
    (tmp_path / "record.csv").write_text(RECORD)
    (tmp_path / "link.csv").symlink_to("record.csv")
    before = {name: (tmp_path / name).read_bytes() for name in ("record.csv", "model.toml", "config.toml")}
    status, _, err = peltier(*words)
    assert (status, len(err.splitlines())) == (2, 1)
    assert f"{option}: is what is read; expected another file" in err
    assert {name: (tmp_path / name).read_bytes() for name in before} == before


def test_two_outputs_in_one_file_are_refused(peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "record.csv").write_text(RECORD)
    status, _, err = peltier("predict", "model.toml", "record.csv", "--out", "p", "--json", "p")
    assert (status, err) == (2, "p: --out and --json: the same file; expected two\n")
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("simulate", "config.toml", "--out", "film_a/record.csv"), "--out: belongs to the run in film_a"),
        (("identify", "record.csv", "--out", "film_a/MODEL.toml"), "--out: belongs to the run in film_a"),
        (("predict", "model.toml", "record.csv", "--json", "film_a/run.json"), "--json: belongs to the run in film_a"),
        (("identify", "record.csv", "--report", "film_a"), "film_a: --report: is a run's folder"),
    ],
)
def test_what_a_run_has_written_stays(
    peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_bench(tmp_path)
    (tmp_path / "record.csv").write_text(RECORD)
    before = dict.fromkeys(("run.json", "record.csv", "MODEL.toml", "report.html"), "two hours of measuring")
    (tmp_path / "film_a").mkdir()
    for name, text in before.items():
        (tmp_path / "film_a" / name).write_text(text)
    status, _, err = peltier(*words)
    assert (status, len(err.splitlines())) == (2, 1)
    assert said in err
    assert {path.name: path.read_text() for path in (tmp_path / "film_a").iterdir()} == before


def test_a_file_beside_a_run_may_be_replaced(peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "record.csv").write_text(RECORD)
    (tmp_path / "film_a").mkdir()
    for name in ("run.json", "mine.csv"):
        (tmp_path / "film_a" / name).write_text("before")
    peltier.succeeds("predict", "model.toml", "record.csv", "--out", "film_a/mine.csv")
    assert "predicted_ohm" in (tmp_path / "film_a" / "mine.csv").read_text()
