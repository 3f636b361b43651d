"""The effect of docs/own_effect.md, as it stands there: simulated, predicted, refused where it is wrong."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig.records.record_file import read_record
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench

PROFILE = '["start 0 A", "hold 2 s", "ramp to 2 A in 30 s", "hold 20 s", "ramp to 0 A in 10 s", "hold 20 s"]'


@pytest.fixture(autouse=True)
def known_here_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file's effect is known for the rest of the process: to other tests it is not."""
    monkeypatch.setattr("sim.effects.catalogue._own", {})


@pytest.fixture
def bench(tmp_path: Path, root: Path) -> Path:
    path = write_bench(tmp_path, target=PROFILE)
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(text.replace("first_degC = 60.0", "first_degC = 40.0\nthermometer_noise_K = 0.0"))
    code = re.search(r"```python\n(.*?)```", (root / "docs" / "own_effect.md").read_text(), re.DOTALL)
    assert code is not None
    (tmp_path / "plate_fin.py").write_text(code[1])
    return path


def test_simulated_and_predicted(bench: Path, peltier: Peltier) -> None:
    folder = bench.parent
    effect = "plate_fin:coupling_per_s=0.02,tau_s=60"
    words = ("--effect-file", folder / "plate_fin.py", "--effect", effect, "--out", folder / "r.csv")
    assert peltier("simulate", bench, *words)[0] == 0
    record = read_record(folder / "r.csv")
    time, current = record["time_s"], record["current_A"]

    def rates(t: float, x: np.ndarray) -> list[float]:
        i = current[min(int((t + 1e-9) / 0.1), time.size - 1)]
        balance = 1.6e-3 * i * (x[0] + 273.15) + 0.03 * i**2 - 0.018 * (x[0] - 25.0)
        return [balance - 0.02 * (x[0] - x[1]), (x[0] - x[1]) / 60.0]

    expected = solve_ivp(rates, (0.0, time[-1]), [40.0, 25.0], t_eval=time, max_step=0.02, rtol=1e-8).y[0]
    np.testing.assert_allclose(record["temperature_degC"], expected, atol=2e-3)
    known = '\n[[effects]]\nname = "plate_fin"\ncoupling_per_s = 0.02\ntau_s = 60\n'
    (folder / "known.toml").write_text(MODEL + known)
    out = peltier.succeeds("predict", folder / "known.toml", folder / "r.csv", *words[:2])
    assert "temperature: RMS error 0.0000 K" in out


def test_from_the_configuration(bench: Path, peltier: Peltier) -> None:
    text = bench.read_text().replace("[simulation]\n", '[simulation]\neffect_files = ["plate_fin.py"]\n')
    bench.write_text(text + '\n[[simulation.effects]]\nname = "plate_fin"\n')
    out = peltier.succeeds("simulate", bench, "--out", bench.parent / "r.csv")
    assert "plate_fin: coupling_per_s = 0.01, tau_s = 100" in out


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("EFFECT = 3\n", "EFFECT: missing"),
        ("def f(:\n", "line 1"),
        ("import nothing_of_this_name\n", "ModuleNotFoundError"),
        ("\nx = 1 / 0\n", "line 2: ZeroDivisionError"),
        (
            "from sim.effects.heat_term import heat_term\n\n\n@heat_term\n"
            "def rate(a, tau_s, s, r, g, ambient, time, plate, own, current):\n    return b * plate\n",
            "line 6: NameError: name 'b' is not defined\n",
        ),
        (None, "no such file"),
    ],
)
def test_a_file_that_is_wrong(bench: Path, peltier: Peltier, code: str | None, told: str) -> None:
    path = bench.parent / "wrong.py"
    if code is not None:
        path.write_text(code)
    err = peltier.fails("simulate", bench, "--effect-file", path, "--out", bench.parent / "r.csv")
    assert err.count("\n") == 1
    assert told in err


@pytest.mark.parametrize(
    "term", ["coupling / 0.0 * plate", "math.nan * plate", "1e9 * plate", "plate / (plate - plate)"]
)
def test_a_term_that_is_no_number_is_told(bench: Path, peltier: Peltier, term: str) -> None:
    """A record of empty fields was written; and of a division by zero one as if there were no such effect."""
    folder = bench.parent
    code = (folder / "plate_fin.py").read_text().replace("-coupling * (plate - fin)", term)
    (folder / "own.py").write_text(f"import math\n\n{code}")
    words = ("--effect-file", folder / "own.py", "--effect", "plate_fin", "--out", folder / "none.csv")
    err = peltier.fails("simulate", bench, *words)
    assert "the simulated temperature is no number any more; effects: plate_fin" in err
    assert not (folder / "none.csv").exists()
