"""What is checked of a target and a model before anything is switched on."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.config.configuration import read_configuration
from rig.config.target import parse_profile
from rig.core.faults import Faults
from rig.experiment.feasibility import KINDS, Kind, target_and_model, target_of
from tests.rig.small import write_bench

PROFILE = '["start 30 degC", "ramp to 70 degC at {rate} K/s", "hold 20 s", "ramp to 30 degC at {rate} K/s"]'
RAMPS = '["start 20 kohm", "ramp to 5 kohm at {rate} dec/s", "hold 20 s", "ramp to 20 kohm at {rate} dec/s"]'


def told(folder: Path, target: str, kind: str) -> str:
    path = write_bench(folder, target=target)
    path.write_text(path.read_text().replace('"track_resistance"', f'"{kind}"'))
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
