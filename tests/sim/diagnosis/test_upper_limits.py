"""Upper limits: above the true size of what is too small to be named, and not far above what could have been found."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from rig.report.diagnosis_words import limit_lines
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.result import UpperLimit
from tests.sim.diagnosis.cases import case


@pytest.mark.parametrize(
    ("effect", "parameter", "seed"),
    [
        ("self_heating", "theta_K_per_W", 1),
        pytest.param("parallel_leakage", "leakage_ohm", 2, marks=pytest.mark.long),
        pytest.param("heat_sink_warmup", "sink_capacity_ratio", 1, marks=pytest.mark.long),
        pytest.param("film_lag", "tau_s", 1, marks=pytest.mark.long),
        pytest.param("actuator_deadband", "deadband_A", 2, marks=pytest.mark.long),
    ],
)
def test_the_true_size_is_below_and_not_far(effect: str, parameter: str, seed: int) -> None:
    hidden = case("smallest", seed, effect=effect, factor=0.6, any_size=True)
    found = diagnose(hidden.columns)
    assert effect not in [f.name for f in found.findings]
    limits = {limit.name: limit for limit in found.limits}
    assert limits[effect].parameter == parameter
    allowed, half = limits[effect].limit, hidden.details["smallest"]
    assert allowed is not None
    assert limits[effect].from_below == (effect in ("parallel_leakage", "heat_sink_warmup"))
    above = half / allowed if limits[effect].from_below else allowed / half
    assert 0.6 < above < 3.0


def test_a_limit_is_read_beside_the_usual_sizes() -> None:
    """What the record excludes whole is told apart from what it says nothing of; an effect that may be there instead of
    one that is named is in neither."""
    limits = [
        UpperLimit("sink", "ratio", 300.0, True, (3.0, 30.0)),
        UpperLimit("leakage", "leakage_ohm", 2e4, True, (1e4, 1e6)),
        UpperLimit("series", "series_ohm", 5000.0, False, (1.0, 600.0)),
        UpperLimit("drift", "drift_K_per_h", 0.001, False, (0.01, 1.0)),
        UpperLimit("creep", "share", None, False, (0.01, 0.3)),
        UpperLimit("lag", "tau_s", 0.1, False, (0.2, 10.0)),
    ]
    findings = [SimpleNamespace(indistinguishable_from=["lag"])]
    assert limit_lines(cast(Any, SimpleNamespace(limits=limits, findings=findings))) == [
        "excluded at every typical size (95 %): sink (ratio above 300); drift (drift below 0.001 K/h)",
        "not seen; still possible (95 %): leakage (leakage above 20,000 ohm)",
        "cannot be seen in this record at any typical size: series (series below 5,000 ohm); creep",
    ]
