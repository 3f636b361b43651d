"""Upper limits: above the true size of what is too small to be named, and below what would be found."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from rig.report.diagnosis_words import limit_lines
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.result import UpperLimit
from tests.truth import record


def test_a_size_below_the_limit_is_not_named_and_one_well_above_it_is() -> None:
    """Else "no leads above 100 ohm" is said of a bench that has more, or could have been said of any bench."""
    hidden_ohm = 10.0
    found = diagnose(record(1, {"series_resistance": {"series_ohm": hidden_ohm}}, rows=2000))
    assert found.findings == ()
    (limit,) = [limit for limit in found.limits if limit.name == "series_resistance"]
    assert (limit.parameter, limit.from_below) == ("series_ohm", False)
    assert limit.limit is not None
    assert limit.limit > hidden_ohm
    larger = diagnose(record(1, {"series_resistance": {"series_ohm": 5.0 * limit.limit}}, rows=2000))
    assert [finding.name for finding in larger.findings] == ["series_resistance"]


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
        "excluded at every typical size (95 %): sink (ratio above 300, typical 3 to 30); "
        "drift (drift below 0.001 K/h, typical 0.01 to 1)",
        "not seen, still possible at this size (95 %): leakage (leakage resistance above 20,000 ohm, typical 10,000 to "
        "1,000,000)",
        "this record cannot show: series; creep",
    ]
