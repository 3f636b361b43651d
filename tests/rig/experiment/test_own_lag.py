"""The program's own short run behind a film that lags by seconds: the lag is the film's, and not the ohmmeter's."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import tomli_w

Peltier = Callable[..., tuple[int, str, str]]
pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.mark.long
def test_a_lag_of_seconds_is_not_taken_for_the_ohmmeters(root: Path, tmp_path: Path, peltier: Peltier) -> None:
    """A film lag of 3.1 s narrows the loop by kelvins. The envelopes found without it, and those bent beside a lag of
    the ohmmeter, were so far off that every descent to a film lag ended elsewhere, and the ohmmeter was blamed."""
    raw = tomllib.loads((root / "configs" / "demo.toml").read_text())
    raw["experiment"]["compare"] = []
    raw["limits"]["meter_current_A"] = 1e-4
    simulation = raw["simulation"]
    del simulation["heat_sink_warmup"]
    simulation["seed"] = 787302
    simulation["film"] = {"kind": "preisach", "decades": 1.9130823019036023, "seed": 726696}
    simulation["effects"] = [{"name": "film_lag", "tau_s": 3.145}]
    (tmp_path / "lagging.toml").write_text(tomli_w.dumps(raw))
    status, _, err = peltier("run", tmp_path / "lagging.toml", "--out", tmp_path / "run")
    assert status == 0, err
    status, _, err = peltier("diagnose", tmp_path / "run" / "record.csv", "--json", tmp_path / "said.json")
    assert status == 0, err
    said = json.loads((tmp_path / "said.json").read_text())
    assert [effect["name"] for effect in said["effects"]] == ["film_lag"]
    assert said["effects"][0]["parameters"]["tau_s"]["value"] == pytest.approx(3.145, rel=0.02)
