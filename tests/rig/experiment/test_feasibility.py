"""What is checked of a target and a model before anything is switched on; where a calibration's minor loops turn."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rig.config.configuration import read_configuration
from rig.config.target import parse_profile
from rig.core.faults import Faults
from rig.experiment.calibration import ASIDE, LEAST_STEP, minor_turning_points, transition_range
from rig.experiment.feasibility import KINDS, Kind, target_and_model, target_of
from tests.rig.small import write_bench

PROFILE = '["start 30 degC", "ramp to 70 degC at {rate} K/s", "hold 20 s", "ramp to 30 degC at {rate} K/s"]'
RAMPS = '["start 20 kohm", "ramp to 5 kohm at {rate} dec/s", "hold 20 s", "ramp to 20 kohm at {rate} dec/s"]'


def told(folder: Path, target: str, kind: str) -> str:
    path = write_bench(folder, target=target, changed=[('"track_resistance"', f'"{kind}"')])
    said: list[str] = []
    target_and_model(read_configuration(path), said.append)
    return "\n".join(said)


@pytest.mark.parametrize(("rate", "faster"), [(0.3, False), (1.0, False), (8.0, True)])
def test_a_temperature(tmp_path: Path, rate: float, faster: bool) -> None:
    """The plate heats by 2.2 K/s at 70 degC and cools by 1.1 K/s at 30 degC, at 4 A."""
    said = told(tmp_path, PROFILE.format(rate=rate), "temperature_profile")
    assert ("faster than the plate" in said) == faster
    assert ("with limits.current_A = 4 A" in said) == faster


@pytest.mark.parametrize(("rate", "faster"), [(0.005, False), (0.2, True)])
def test_a_resistance(tmp_path: Path, rate: float, faster: bool) -> None:
    """It crosses the loop at its turn, for which no target leaves time: that alone is not told."""
    said = told(tmp_path, RAMPS.format(rate=rate), "track_resistance")
    assert ("faster than the plate" in said) == faster


@pytest.mark.parametrize(("seen_degC", "beyond"), [((40.0, 90.0), False), ((40.0, 62.0), True)])
def test_temperatures_beyond_the_film_s_record(tmp_path: Path, seen_degC: tuple[float, float], beyond: bool) -> None:
    path, said = write_bench(tmp_path, target=RAMPS.format(rate=0.005)), []
    model = tmp_path / "model.toml"
    model.write_text(f"film_seen_degC = {list(seen_degC)}\n{model.read_text()}")
    target_and_model(read_configuration(path), said.append)
    assert ("beyond 40.0 to 62.0 degC, where the film was measured" in "\n".join(said)) == beyond


def test_faults_of_target_and_model_are_told_at_once(tmp_path: Path) -> None:
    path = write_bench(tmp_path, target='["start 20 kohm", "leap to 5 kohm"]')
    model = tmp_path / "model.toml"
    model.write_text(model.read_text().replace('kind = "peltier"', 'kind = "oven"'))
    with pytest.raises(Faults) as told:
        target_and_model(read_configuration(path), print)
    assert len(told.value.lines) == 2
    assert "leap to 5 kohm" in told.value.lines[0]
    assert "plate.kind" in told.value.lines[1]


def test_a_kind_with_keys_of_its_own_needs_no_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who adds one says how its target follows from them; without that each of its runs was refused."""
    made = parse_profile(["start 40 degC", "hold 5 s"], "temperature", "a test")
    monkeypatch.setitem(KINDS, "hold", Kind("temperature", target=lambda file: made))  # type: ignore[arg-type]
    path = write_bench(tmp_path, experiment='[experiment]\nkind = "hold"\nmodel = "model.toml"\n')
    assert target_of(read_configuration(path)) is made


@pytest.mark.parametrize("loops", [2, 7, 14, 200])
def test_loops_turn_about_the_transition_and_are_none_of_them_alike(loops: int) -> None:
    """The widest may go beyond an end of it, as far as the calibration's range lets them."""
    low, high = 52.0, 71.0
    within, beyond = (51.0, 73.0), ASIDE * (high - low)
    for seed in range(300):
        points = minor_turning_points((low, high), within, loops, seed)
        assert len(points) == 2 * loops
        assert max(within[0], low - beyond) <= min(points) < max(points) <= min(within[1], high + beyond)
        steps = np.abs(np.diff(points))
        nested = 2 * max(2, loops // 3)
        assert low <= min(points[nested:], default=low) <= max(points[nested:], default=high) <= high
        assert np.min(steps[nested:], initial=high) > 0.999 * LEAST_STEP * (high - low)
        turned = [pair for pair in pairwise(points) if set(pair) != set(within)]
        assert len(set(turned)) == len(turned)


def major_loop(sign: float) -> tuple[Any, np.ndarray, np.ndarray]:
    """A film that switches at 70 degC and back at 55, on a plate that is slowest just before either; sign: of log10 R
    with the temperature."""
    shares, at = (0.0, 0.1, 0.9, 1.0), np.linspace(0.0, 1.0, 800)
    down, up = np.interp(at, shares, (72.0, 58.0, 56.0, 52.0)), np.interp(at, shares, (52.0, 67.0, 69.0, 72.0))
    v = np.concatenate([down, up])
    switched = 1.0 / (1.0 + np.exp(-(v - np.where(np.arange(v.size) < down.size, 55.0, 70.0)) / 0.3))
    log = 3.0 + sign * switched
    columns = {"phase": np.full(v.size, "major"), "temperature_degC": v, "resistance_ohm": 10.0**log}
    return SimpleNamespace(column=columns.__getitem__), v, log


@pytest.mark.parametrize("sign", [-1.0, 1.0], ids=["falls", "rises"])
def test_the_transition_is_found_where_the_correlation_has_the_other_sign(sign: float) -> None:
    folder, v, log = major_loop(sign)
    assert sign * np.corrcoef(v, log)[0, 1] < -0.5
    assert transition_range(folder) == pytest.approx((54.0, 71.0), abs=0.5)
