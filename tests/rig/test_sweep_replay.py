"""peltier sweep goes on where it was interrupted; peltier replay gives the same bits, and another law on the twin."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

from tests.rig.small import write_bench

Peltier = Callable[..., tuple[int, str, str]]
SWEEP = """
[sweep]
seeds = 2
effects = [[], ["film_lag:tau_s=1"]]
[sweep.parameters]
"control.ms" = [1.3]
"""


def test_a_sweep_and_its_second_half(tmp_path: Path, peltier: Peltier) -> None:
    target = '["start 1 A", "hold 5 s", "ramp to 2 A in 5 s"]'
    path = write_bench(tmp_path, target=target, more=SWEEP)
    path.write_text(path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"'))
    words = ("sweep", path, "--out", tmp_path / "s", "--workers", 1, "--records")
    status, out, err = peltier(*words)
    assert status == 0, err
    assert "4 experiments, 0 of them" in out
    assert err.count("\n") == 4
    table = tmp_path / "s" / "sweep.csv"
    whole = table.read_text()
    rows = list(csv.DictReader(whole.splitlines()))
    assert [row["effects"] for row in rows] == ["", "", "film_lag:tau_s=1", "film_lag:tau_s=1"]
    assert len(list((tmp_path / "s").glob("record_*.csv"))) == 4
    table.write_text("".join(whole.splitlines(keepends=True)[:3]))
    status, _, err = peltier(*words)
    assert status == 0
    assert err.count("\n") == 2
    assert sorted(table.read_text().splitlines()) == sorted(whole.splitlines())
    path.write_text(path.read_text().replace("tau_s=1", "tau_s=2"))
    status, _, err = peltier(*words)
    assert status == 2
    assert "is of another sweep" in err


def test_a_sweep_that_cannot_be_is_refused(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path, more=SWEEP.replace("film_lag:tau_s=1", "film_lg"))
    status, _, err = peltier("sweep", path, "--out", tmp_path / "s")
    assert status == 2
    assert "did you mean 'film_lag'?" in err
    path.write_text(path.read_text().replace("film_lg", "film_lag").replace("control.ms", "control.sm"))
    status, _, err = peltier("sweep", path, "--out", tmp_path / "s")
    assert status == 2
    assert "control.sm: unknown key" in err
    assert not (tmp_path / "s").exists()


def test_replay_gives_the_same_commands_and_another_law_runs_on_the_twin(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path)
    with (tmp_path / "model.toml").open("a") as model:
        model.write('\n[[effects]]\nname = "film_lag"\ntau_s = 1.0\n')
    assert peltier("run", path, "--out", tmp_path / "run")[0] == 0
    status, out, _ = peltier("replay", tmp_path / "run", "--json", "-")
    assert status == 0
    assert json.loads(out)["different"] == 0
    assert json.loads(out)["compared"] > 400
    rows = (tmp_path / "run" / "record.csv").read_text().splitlines()
    fields = rows[-50].split(",")
    fields[1] = repr(float(fields[1]) + 0.01)
    (tmp_path / "run" / "record.csv").write_text("\n".join([*rows[:-50], ",".join(fields), *rows[-49:]]) + "\n")
    assert peltier("replay", tmp_path / "run")[0] == 1
    path.write_text(path.read_text().replace("period_s = 0.1", "period_s = 0.2"))
    status, out, _ = peltier("replay", tmp_path / "run", "--config", path, "--out", tmp_path / "twin.csv")
    assert status == 0
    assert "rms_dec" in out


def test_a_run_whose_record_lacks_a_column_says_so(tmp_path: Path, peltier: Peltier) -> None:
    assert peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")[0] == 0
    record = tmp_path / "run" / "record.csv"
    whole = record.read_text()
    for column in ("phase", "target_ohm"):
        record.write_text(whole.replace(column, "lost", 1))
        status, _, err = peltier("replay", tmp_path / "run")
        assert (status, err) == (2, f"{record}: {column}: missing; expected the column of a run's record\n")
