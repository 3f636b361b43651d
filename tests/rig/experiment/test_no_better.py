"""What tells a run no better than the model that it had: a film by the film, what is before it by the temperature."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from rig.experiment.improvement import no_better
from rig.records.film_output import FALLING_RESISTANCE
from rig.records.record_file import Record, read_record
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench

CURRENTS = '["start 1 A", "hold 20 s", "ramp to 2.5 A in 60 s", "ramp to -0.5 A in 60 s", "ramp to 1.5 A in 40 s"]'
SINK = ("heat_sink_warmup", "sink_capacity_ratio = 8.0\nsink_conductance_ratio_per_s = 0.1")
LAG = ("film_lag", "tau_s = 3.0")
TOO_LATE = ("film_lag", "tau_s = 12.0")


@pytest.fixture
def recorded(tmp_path: Path, peltier: Peltier) -> Callable[[str, str], Record]:
    path = write_bench(tmp_path, target=CURRENTS)
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(text.replace("period_s = 0.1", "period_s = 0.5"))

    def simulated(name: str, parameters: str) -> Record:
        effect = f"{name}:{parameters}".replace(" ", "").replace("\n", ",")
        assert peltier("simulate", path, "--effect", effect, "--out", tmp_path / "record.csv")[0] == 0
        return read_record(tmp_path / "record.csv")

    return simulated


def why_not(folder: Path, record: Record, *effects: tuple[str, str]) -> str | None:
    own, extended = folder / "own.toml", folder / "extended.toml"
    own.write_text(MODEL, encoding="utf-8")
    tables = (f'\n[[effects]]\nname = "{name}"\n{parameters}\n' for name, parameters in effects)
    extended.write_text(MODEL + "".join(tables), encoding="utf-8")
    return no_better(extended, own, record, FALLING_RESISTANCE, [name for name, _ in effects])


def test_what_is_before_the_film_shows_in_temperature(tmp_path: Path, recorded: Callable[[str, str], Record]) -> None:
    """The film follows the thermometer as well without the sink: 0.0029 decades with it by the current, 0.0024
    without it by the thermometer, for 0.02 K in the place of 2 K."""
    assert why_not(tmp_path, recorded(*SINK), SINK) is None


def test_a_film_is_told_by_the_film(tmp_path: Path, recorded: Callable[[str, str], Record]) -> None:
    lagging = recorded(*LAG)
    assert why_not(tmp_path, lagging, LAG) is None
    found = why_not(tmp_path, lagging, SINK, TOO_LATE)
    assert found is not None
    assert found.startswith("with the extended model log R of the run's own record is predicted to ")
    assert why_not(tmp_path, recorded(*SINK), SINK, TOO_LATE) is not None
