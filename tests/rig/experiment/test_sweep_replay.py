"""peltier sweep goes on where it was interrupted; peltier replay gives the same bits, and another law on the twin."""

from __future__ import annotations

import csv
import json
import random
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from scipy.io import netcdf_file

from rig.bench.assembly import open_bench
from rig.config.configuration import read_configuration
from rig.control.loop import Loop
from rig.experiment.run_record import Session, one_run
from rig.safety.signals import SignalStop
from rig.version import __version__, source_digest
from tests.peltier import Peltier
from tests.rig.small import write_bench

pytestmark = pytest.mark.usefixtures("undrawn", "computed_here")
SWEEP = """
[sweep]
seeds = 2
effects = [[], ["film_lag:tau_s=1"]]
[sweep.parameters]
"control.ms" = [1.3]
"""


def test_a_sweep_and_its_second_half(tmp_path: Path, peltier: Peltier) -> None:
    target = '["start 1 A", "hold 5 s", "ramp to 2 A in 5 s"]'
    path = write_bench(tmp_path, target=target, more=SWEEP, kind="current_profile")
    words = ("sweep", path, "--out", tmp_path / "s", "--workers", 1, "--records")
    status, out, err = peltier(*words)
    assert status == 0, err
    assert "4 cases, 0 of them" in out
    table, journal = tmp_path / "s" / "sweep.csv", tmp_path / "s" / "cases.jsonl"
    assert "4 of 4 cases" in err
    whole, lines = table.read_text(), journal.read_text().splitlines(keepends=True)
    rows = list(csv.DictReader(whole.splitlines()))
    assert [row["effects"] for row in rows] == ["", "", "film_lag:tau_s=1", "film_lag:tau_s=1"]
    assert len(list((tmp_path / "s").glob("record_*.csv"))) == 4
    journal.write_text("".join(lines[:2]) + lines[2][:30])  # killed in the middle of a line
    table.unlink()
    peltier.succeeds(*words)
    assert table.read_text() == whole
    assert journal.read_text().startswith("".join(lines[:2]))
    assert len(journal.read_text().splitlines()) == 4
    with netcdf_file(tmp_path / "s" / "sweep.nc", mmap=False) as file:
        assert list(file.variables["number"][:]) == [0.0, 1.0, 2.0, 3.0]
        assert [b"".join(text).rstrip(b"\0") for text in file.variables["effects"][:]][-1] == b"film_lag:tau_s=1"
    path.write_text(path.read_text().replace("tau_s=1", "tau_s=2"))
    assert "is of other cases" in peltier.fails(*words)


@pytest.mark.parametrize(
    ("controller", "meter"),
    [pytest.param("meerstetter", "keithley2000", marks=pytest.mark.long), ("srs_ldc500", "keithley2400")],
)
def test_a_simulation_is_the_same_each_time(tmp_path: Path, peltier: Peltier, controller: str, meter: str) -> None:
    """Whatever process computes it: the first numbers of a conversation are random on a real line alone."""
    path = write_bench(tmp_path, changed=[('"meerstetter"', f'"{controller}"'), ('"keithley2000"', f'"{meter}"')])
    records = []
    for seed in (1, 2, 3):
        random.seed(seed)  # as of another process
        peltier.succeeds("simulate", path, "--out", tmp_path / f"{seed}.csv")
        records.append((tmp_path / f"{seed}.csv").read_bytes())
    assert records[0] == records[1] == records[2]


def test_a_sweep_that_cannot_be_is_refused(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path, more=SWEEP.replace("film_lag:tau_s=1", "film_lg"))
    assert "did you mean 'film_lag'?" in peltier.fails("sweep", path, "--out", tmp_path / "s")
    path.write_text(path.read_text().replace("film_lg", "film_lag").replace("control.ms", "control.sm"))
    assert "control.sm: unknown key" in peltier.fails("sweep", path, "--out", tmp_path / "s")
    path.write_text(path.read_text().replace("[sweep]", "[sweep]\nworkers = 2"))
    assert f"{path}: sweep.workers: unknown key" in peltier.fails("sweep", path, "--out", tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_replay_gives_the_same_commands_and_another_law_runs_on_the_twin(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path)
    with (tmp_path / "model.toml").open("a") as model:
        model.write('\n[[effects]]\nname = "film_lag"\ntau_s = 1.0\n')
    assert peltier("run", path, "--out", tmp_path / "run")[0] == 0
    out = peltier.succeeds("replay", tmp_path / "run", "--json", "-")
    assert json.loads(out)["different"] == 0
    assert json.loads(out)["compared"] > 400
    rows = (tmp_path / "run" / "record.csv").read_text().splitlines()
    fields = rows[-50].split(",")
    fields[1] = repr(float(fields[1]) + 0.01)
    (tmp_path / "run" / "record.csv").write_text("\n".join([*rows[:-50], ",".join(fields), *rows[-49:]]) + "\n")
    assert peltier("replay", tmp_path / "run")[0] == 1
    path.write_text(path.read_text().replace("period_s = 0.1", "period_s = 0.2"))
    out = peltier.succeeds("replay", tmp_path / "run", "--config", path, "--out", tmp_path / "twin.csv")
    assert "rms_dec" in out


HEATED = '\n[[effects]]\nname = "self_heating"\ntheta_K_per_W = 300.0\n'


@pytest.mark.parametrize("effect", ["", pytest.param(HEATED, marks=pytest.mark.long)])
def test_replay_of_late_ticks(tmp_path: Path, peltier: Peltier, monkeypatch: pytest.MonkeyPatch, effect: str) -> None:
    """A third of the ticks is late, by up to three periods; the target's ohms are on no grid."""
    laws = ["full", "feedforward", "pid", "instrument_pid"]
    chance = random.Random(1)
    target = [(4.0 * k, 10.0 ** (4.2 - 0.1 * k + 0.01 * chance.random())) for k in range(4)]
    lines = ["time_s,target_ohm", *(f"{time!r},{ohm!r}" for time, ohm in target)]
    (tmp_path / "target.csv").write_text("\n".join(lines) + "\n")
    path = write_bench(tmp_path, target='"target.csv"')
    path.write_text(path.read_text().replace("settle_s", f"compare = {json.dumps(laws[1:])}\nsettle_s"))
    with (tmp_path / "model.toml").open("a") as model:
        model.write(effect)
    tick = Loop._tick

    def late(self: Loop, *rest: Any) -> bool:
        if chance.random() < 0.33:
            self.bench.clock.sleep_until_s(self.bench.clock.now_s() + 0.3 * chance.random())
        return tick(self, *rest)

    monkeypatch.setattr(Loop, "_tick", late)
    run = tmp_path / "run"
    assert peltier("run", path, "--out", run)[0] == 0
    for law in laws:
        status, out, _ = peltier("replay", run if law == "full" else run / law, "--json", "-")
        found = json.loads(out)
        assert (status, found["different"]) == (0, 0), law
        assert found["compared"] > 100
        assert found["other_versions"] == {}
    ticks = json.loads((run / "pid" / "run.json").read_text())["stop"]["ticks"]
    assert ticks["missed"] > 10


def test_a_run_of_another_version_says_so(finished_run: Path, peltier: Peltier) -> None:
    document = json.loads((finished_run / "run.json").read_text())
    assert document["start"]["versions"]["sources"] == source_digest()
    document["start"]["versions"] |= {"peltier-rig": "0.0.9", "sources": "0123456789abcdef"}
    (finished_run / "run.json").write_text(json.dumps(document))
    out = peltier.succeeds("replay", finished_run)
    assert f"the run was made with peltier-rig 0.0.9, this is {__version__}: bits may differ" in out
    assert f"made with sources 0123456789abcdef, this is {source_digest()}" in out


def test_a_run_whose_record_lacks_a_column_says_so(finished_run: Path, peltier: Peltier) -> None:
    record = finished_run / "record.csv"
    whole = record.read_text()
    for column in ("phase", "target_ohm"):
        record.write_text(whole.replace(column, "lost", 1))
        status, _, err = peltier("replay", finished_run)
        assert (status, err) == (2, f"{record}: {column}: missing; expected the column of a run's record\n")


LAW = '''
from rig.control.decision import Decision


class Ramp:
    """Goes by what it remembers: each tick a little more, of the temperature too."""

    def __init__(self, step_A):
        self.step_A, self.ticks = step_A, 0

    def decide(self, time_s, temperature_degC, output, read):
        self.ticks += 1
        return Decision(self.step_A * self.ticks + 1e-4 * temperature_degC)
'''


def own_run(folder: Path, law: Any, *names: str) -> Path:
    """A run of a user-defined law in a phase of each name, one after the other."""
    file = read_configuration(write_bench(folder), for_experiment=False)
    with (
        SignalStop() as signals,
        open_bench(file) as bench,
        one_run(Session(bench, file, signals, lambda text: None), folder / "mine", "ramp") as (loop, run),
    ):
        for name in names:
            loop.phase(name, law, duration_s=2.0, period_s=0.1)
    return run.finish()


def test_an_own_law_is_replayed_from_the_run(tmp_path: Path, peltier: Peltier, monkeypatch: pytest.MonkeyPatch) -> None:
    """With its state at the start of each phase, wherever the file is that it came from, and whatever became of it."""
    (tmp_path / "ramp_law.py").write_text(LAW)
    monkeypatch.syspath_prepend(tmp_path)
    run = own_run(tmp_path, import_module("ramp_law").Ramp(0.01), "first", "second")
    (tmp_path / "ramp_law.py").unlink()
    assert (run / "ramp_law.py").read_text() == LAW
    status, out, err = peltier("replay", run)
    assert (status, out.splitlines()[0]) == (0, "40 of 40 commands are the same, bit for bit"), err
    (run / "ramp_law.py").write_text(LAW.replace("1e-4", "2e-4"))
    status, out, _ = peltier("replay", run)
    assert status == 1
    assert "0 of 40 commands are the same" in out
    (run / "ramp_law.py").write_text(f"import not_there\n{LAW}")
    err = peltier.fails("replay", run)
    assert err == (
        f"{run / 'ramp_law.py'}: Ramp cannot be made again: ModuleNotFoundError: No module named 'not_there'; "
        "expected the file as it ran, with what it imports beside it\n"
    )


def test_a_law_that_stands_in_no_file_is_said_not_to_be_kept(tmp_path: Path, peltier: Peltier) -> None:
    """To import a script again would run its experiment again, on a real rig maybe."""
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(LAW, names)
    run = own_run(tmp_path, names["Ramp"](0.01), "alone")
    err = peltier.fails("replay", run)
    assert "phase 'alone': its law is not in the run folder: it stands in" in err
    assert "expected its class in a file of its own" in err
