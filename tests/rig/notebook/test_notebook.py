"""`import rig`: light, the same answers as the verbs, faults in lines, and a bench that ends with its output off."""

from __future__ import annotations

import inspect
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import rig
from rig.core.faults import python_words
from rig.core.outcome import NotConfirmedOff
from rig.drivers.meerstetter import MeerstetterController
from rig.records.record_file import write_columns
from tests.peltier import Peltier
from tests.rig.control.test_ways_out import at_row
from tests.rig.drivers.disobedient import Disobedient
from tests.rig.small import MODEL, change_instrument, write_bench

PROFILE = ["start 1.1 A", "sine 1.7 A period 120 s for 240 s"]


@pytest.fixture(scope="module")
def record() -> rig.Record:
    """Two sweeps through the transition of the template's film."""
    tables = rig.simulated_rig()
    tables["experiment"] = {"kind": "current_profile", "period_s": 0.5, "target": PROFILE}
    tables["simulation"]["first_degC"] = 45.0
    return rig.simulate(tables).record


def test_import_is_light() -> None:
    code = (
        "import sys; before = set(sys.modules); import rig; dir(rig);"
        "more = {m for m in set(sys.modules) - before if m.partition('.')[0] not in sys.stdlib_module_names};"
        "print(sorted(more))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "['compensator', 'rig']\n"


def test_every_name_has_an_example_that_runs_and_a_docstring(root: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", (root / "docs" / "python.md").read_text("utf-8"), re.M | re.S)
    code = "\n".join(blocks)
    reference = "".join(page.read_text("utf-8") for page in (root / "docs" / "api").glob("*.md"))
    for name in rig.__all__:
        assert re.search(rf"\brig\.{name}\b", code), name
        value = getattr(rig, name)
        if callable(value):
            assert inspect.getdoc(value), name
            assert f"\n## {value.__name__}\n" in reference, name
    assert dir(rig) == sorted(rig.__all__)  # completion offers these alone
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        rig.nothing  # noqa: B018


def test_a_record_of_each_kind(record: rig.Record, tmp_path: Path) -> None:
    columns = {"t / s": record["time_s"], "T [K]": record["temperature_degC"] + 273.15}
    pandas = pytest.importorskip("pandas")
    write_columns(tmp_path / "r.csv", columns)
    for source in (columns, tmp_path / "r.csv", str(tmp_path / "r.csv"), pandas.DataFrame(columns)):
        read = rig.read_record(source)
        np.testing.assert_allclose(read["temperature_degC"], record["temperature_degC"], atol=1e-9)
        assert any("T [K]" in line for line in read.notes)
    assert rig.read_record({"time_s": [0.0, 1.0], "V": [2, 3]}, "temperature_degC=V").rows == 2


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: rig.read_record(7), "read_record: source: expected a file's path, .*, not int"),
        (lambda: rig.read_record("nothing.csv"), "nothing.csv: no such file"),
        (lambda: rig.read_record({"time_s": [0, 1]}), "arrays: column 'temperature_degC' missing"),
        (lambda: rig.predict(3, {}), "model: expected a Model, .*, not int"),
        (lambda: rig.simulate(3), "configuration: expected a file's path or tables by name, not int"),
        (lambda: rig.simulate({}), "configuration: bench"),
        (lambda: rig.simulate({"a": object()}), "configuration: .*object"),
        (lambda: rig.simulate(effects=["nothing"]), 'effects="nothing" is no effect'),
        (lambda: rig.invert(rig.Model(None, None), [1e4]), "model: film: missing"),
        (lambda: rig.write_model("m.toml", 3), "model: expected a Model"),
        (lambda: rig.diagnose({}, base="pi"), "base 'pi': expected one of extended_generalized_pi, generalized_pi"),
        (lambda: rig.diagnose({}, plate="oven"), "plate 'oven': expected one of peltier, heater"),
    ],
)
def test_faults_are_lines(call: Callable[[], object], line: str) -> None:
    with pytest.raises(rig.Faults, match=line) as caught:
        call()
    assert all(one and "\n" not in one for one in caught.value.lines)


def test_the_same_as_the_verbs(record: rig.Record, tmp_path: Path, peltier: Peltier) -> None:
    path, model, target = (tmp_path / name for name in ("r.csv", "m.toml", "t.csv"))
    write_columns(path, record.columns)
    found = rig.identify(path)
    out = peltier.succeeds("identify", path, "--out", model, "--json", tmp_path / "i.json")
    assert list(found.lines) == out.splitlines()[:-1]
    rig.write_model(tmp_path / "mine.toml", found)
    assert rig.read_model(tmp_path / "mine.toml").film is not None
    assert [line for line in model.read_text().splitlines() if line[:1] != "#"] == [
        line for line in (tmp_path / "mine.toml").read_text().splitlines() if line[:1] != "#"
    ]
    assert peltier("predict", model, path, "--initial", "fitted", "--json", tmp_path / "p.json")[0] == 0
    predicted, verb = rig.predict(found, path, initial="fitted"), json.loads((tmp_path / "p.json").read_text())
    assert (predicted.rmse_dec, predicted.rmse_K) == (verb["rmse_dec"], verb["rmse_K"])
    assert predicted.fitted == verb["fitted"]
    target.write_text("time_s,target_ohm\n0,30000\n1,1\n2,10000\n")
    assert peltier("invert", model, target, "--out", tmp_path / "v.csv")[0] == 0
    inverted = rig.read_record(tmp_path / "v.csv")
    mine = rig.invert(found, [30000, 1, 10000])
    assert mine.reachable.tolist() == [True, False, True]
    for name, values in mine.columns().items():
        np.testing.assert_array_equal(values, inverted[name])


def test_results_show_themselves(record: rig.Record) -> None:
    found = rig.identify(record)
    predicted = rig.predict(found, record)
    for shown in (found, predicted):
        assert "RMS error" in str(shown)
        assert shown._repr_html_().count("<svg") == 1
        assert [axes.lines for axes in shown.plot().axes]
    plate = rig.identify({name: record[name] for name in ("time_s", "temperature_degC", "current_A")})
    assert plate.film is None
    assert plate.plot().axes[0].get_ylabel().startswith("temperature")


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_after_precompile_a_notebooks_hour_compiles_nothing(root: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-m", "rig", "precompile"], check=True, env=environment, cwd=tmp_path)
    page = (root / "docs" / "python.md").read_text("utf-8")
    code = "\n".join(re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL))
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, cwd=tmp_path)
    assert "compiling" not in done.stderr


# ---- the bench


@pytest.fixture
def bench_file(tmp_path: Path) -> Path:
    return write_bench(tmp_path)


def armed(bench: Any, current_A: float = 1.0) -> Any:
    """The bench with a current on."""
    bench.controller.arm_current()
    bench.controller.set_current_A(current_A)
    assert bench.controller.status().output_is_on
    return bench


def test_read_and_run(bench_file: Path, tmp_path: Path) -> None:
    with rig.open_bench(bench_file) as bench:
        reading = bench.read()
        assert reading.temperature_degC == pytest.approx(60.0, abs=0.5)
        assert 1e3 < reading.resistance_ohm < 1e6
        done = bench.run(tmp_path / "run", target=["start 20 kohm", "hold 5 s"])
        assert not bench.controller.status().output_is_on
        assert bench.read().time_s > reading.time_s
    assert (done.folder / "report.html").is_file()
    assert done.record.has("target_ohm")
    assert done.scores[0].rms < 0.05
    with pytest.raises(rig.Faults, match=r"experiment\.law"), rig.open_bench(bench_file) as bench:
        bench.run(law="nothing")


def test_a_run_and_a_calibration_in_one_line(bench_file: Path, tmp_path: Path) -> None:
    """Whoever has a configuration writes no block; what the block refuses is refused all the same."""
    done = rig.run(bench_file, tmp_path / "run", target=["start 20 kohm", "hold 2 s"])
    assert done.scores[0].rms < 0.05
    with pytest.raises(rig.Faults, match=r"is there already|exists"):
        rig.calibrate(bench_file, tmp_path / "run")


class Surprise(BaseException):
    """What no `except Exception` catches."""


@pytest.mark.parametrize("ends", [None, ValueError, KeyboardInterrupt, SystemExit, Surprise, "SIGINT", "SIGTERM"])
def test_off_whatever_ends_the_block(ends: Any, bench_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[Any] = []
    closed = MeerstetterController.close

    def close(self: Any) -> None:
        kept.append(self.status().output_is_on)
        closed(self)

    monkeypatch.setattr(MeerstetterController, "close", close)
    expected = {"SIGINT": KeyboardInterrupt, "SIGTERM": SystemExit}.get(ends, ends)

    def work() -> None:
        with rig.open_bench(bench_file) as bench:
            armed(bench)
            if isinstance(ends, str):
                with suppress(KeyboardInterrupt, SystemExit):  # a user's code may catch it; the next one comes
                    signal.raise_signal(getattr(signal, ends))
                signal.raise_signal(getattr(signal, ends))
            elif ends is not None:
                raise ends

    before = signal.getsignal(signal.SIGINT)
    if expected is None:
        work()
    else:
        with pytest.raises(expected):
            work()
    assert kept == [False]
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_waits_while_the_output_is_switched_off(bench_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    off, close, closing, kept = MeerstetterController.off, MeerstetterController.close, False, []

    def interrupted(self: Any) -> bool:
        if closing:
            signal.raise_signal(signal.SIGINT)
        return bool(off(self))

    def closed(self: Any) -> None:
        kept.append(self.status().output_is_on)
        close(self)

    monkeypatch.setattr(MeerstetterController, "off", interrupted)
    monkeypatch.setattr(MeerstetterController, "close", closed)

    def work() -> None:
        nonlocal closing
        with rig.open_bench(bench_file) as bench:
            armed(bench)
            closing = True

    with pytest.raises(KeyboardInterrupt):
        work()
    assert kept == [False]


def test_a_signal_in_a_run_is_an_interrupt(bench_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    at_row(monkeypatch, 20, lambda: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt), rig.open_bench(bench_file) as bench:
        bench.run(tmp_path / "run", target=["start 20 kohm", "hold 5 s"])
    ended = json.loads((tmp_path / "run.part" / "run.json").read_text())
    assert ended["stop"]["output_off_confirmed"] is True


def test_not_confirmed_off_says_what_to_do(bench_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Disobedient] = []

    def wrap(controller: Any) -> Disobedient:
        made.append(Disobedient(controller, "silent"))
        return made[0]

    change_instrument(monkeypatch, "controller", wrap)

    def work() -> None:
        with rig.open_bench(bench_file) as bench:
            armed(bench)
            made[0].begin()

    with pytest.raises(NotConfirmedOff) as caught:
        work()
    assert "Switch the controller off by hand" in caught.value.__notes__[-1]


def test_real_ports_need_somebody_who_switches_off(tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    text = path.read_text().replace("sim://", "/dev/nothing").replace('time = "virtual"', 'time = "real"')
    path.write_text(text.replace('driver = "meerstetter"', 'driver = "te_technology"'))
    with pytest.raises(rig.Faults, match="has no dead man of its own, and this system has no guard process"):
        rig.open_bench(path).__enter__()
    path.write_text(text)
    with pytest.raises(Exception, match="/dev/nothing"):
        rig.open_bench(path).__enter__()


def test_a_record_shows_itself_in_a_few_lines() -> None:
    """A night's record, printed in a notebook, is not its numbers."""
    time = np.arange(100_000.0)
    ohm = np.where(time % 2 == 0, 1e4, np.nan)
    record = rig.read_record({"time_s": time, "temperature_degC": 20.0 + 1e-3 * time, "resistance_ohm": ohm})
    assert str(record).splitlines() == [
        "Record of arrays: 100000 rows",
        "  time_s: 0 to 99999",
        "  temperature_degC: 20 to 119.999",
        "  resistance_ohm: 10000 to 10000, 50000 readings",
    ]
    assert repr(record) == str(record)


def test_a_record_becomes_a_data_frame_and_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, Any] = {}
    pandas = ModuleType("pandas")
    pandas.DataFrame = lambda columns: seen.update(columns) or "frame"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    record = rig.Record({"time_s": np.arange(3.0)}, text_columns={"phase": ["a", "a", "b"]})
    assert record.to_frame() == "frame"
    assert list(seen) == ["time_s", "phase"]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(rig.Faults, match=r"^to_frame: pandas: is not installed; `pip install pandas` has it"):
        record.to_frame()


@pytest.mark.parametrize(
    ("typed", "python"),
    [
        ("a.csv: no T; expected --column temperature_degC=...", 'a.csv: no T; expected column="temperature_degC=..."'),
        ("--column 'a=t / s' --column 'b=x'", 'column=["a=t / s", "b=x"]'),
        ("expected --decimal , or --decimal .", 'expected decimal="," or decimal="."'),
        (
            "--drive: current: no [plate]; expected --drive temperature",
            'drive="current": no [plate]; expected drive="temperature"',
        ),
        ("--first: 5: expected --initial fitted beside it", 'first_s=5: expected initial="fitted" beside it'),
        ("runs/x: --out: is there already", "runs/x: out: is there already"),
        ("(--column maps names)", "(column maps names)"),
        ("--period 0.5, --reversed", "period_s=0.5, reversed=True"),
        ("a -- b, x--y, 5 -- --", "a -- b, x--y, 5 -- --"),
    ],
)
def test_messages_in_python_speak_python(typed: str, python: str) -> None:
    assert python_words(typed) == python


def test_every_door_speaks_python(tmp_path: Path) -> None:
    """Whoever has typed no command is not told of its options."""
    columns = {"time_s": [0.0, 1.0, 2.0], "R": [20.1, 19.8, 19.2]}
    (tmp_path / "model.toml").write_text(MODEL)
    model = rig.read_model(tmp_path / "model.toml")
    record = rig.Record({"time_s": np.arange(30.0), "temperature_degC": np.linspace(20.0, 60.0, 30)})
    for call in (
        lambda: rig.read_record(columns),
        lambda: rig.read_record(columns, needs=("temperature_degC",)),
        lambda: rig.identify(columns),
        lambda: rig.predict(model, record, drive="current"),
        lambda: rig.predict(model, record, first_s=5.0),
        lambda: rig.predict(model, record, initial="fitted"),
        lambda: rig.simulate(seed=-1),
    ):
        with pytest.raises(rig.Faults) as caught:
            call()
        assert "--" not in str(caught.value)
    with pytest.raises(rig.Faults, match='expected column="resistance_ohm=R@'):
        rig.read_record(columns)
