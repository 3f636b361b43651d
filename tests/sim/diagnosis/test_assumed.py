"""Effects that the user knows are there, and a diagnosis that has only so much time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from tests.truth import record

Columns = dict[str, np.ndarray]
TAU_S = 1.5


@pytest.fixture(scope="module")
def lagging() -> Columns:
    return record(1, {"sensor_lag": {"tau_s": TAU_S}}, rows=2000)


def test_what_is_assumed_is_fitted_and_not_found(lagging: Columns) -> None:
    found = diagnose(lagging, assume={"sensor_lag": {}})
    assert found.verdict == "clean"
    assert found.findings == ()
    value, interval = found.assumed["sensor_lag"]["tau_s"]
    assert interval is not None
    assert interval[0] < value < interval[1]
    assert value == pytest.approx(TAU_S, rel=0.01)
    channel = found.channels["temperature_K"]
    assert channel is not None
    assert channel.rmse_base == channel.rmse_extended  # the base model has it, too
    document = found.document()
    assert [effect["name"] for effect in document["assumed"]] == ["sensor_lag"]
    assert "sensor_lag" not in [limit["name"] for limit in document["upper_limits"]]


def test_what_is_known_of_it_is_not_fitted(lagging: Columns) -> None:
    found = diagnose(lagging, assume={"sensor_lag": {"tau_s": TAU_S}})
    assert found.verdict == "clean"
    assert found.assumed == {"sensor_lag": {"tau_s": (TAU_S, None)}}


@pytest.mark.long
def test_a_wrong_assumption_leaves_something(lagging: Columns) -> None:
    found = diagnose(lagging, assume={"sensor_lag": {"tau_s": 0.3 * TAU_S}})
    assert found.assumed["sensor_lag"]["tau_s"] == (0.3 * TAU_S, None)
    assert found.verdict != "clean"


@pytest.mark.parametrize(
    ("without", "name", "said"),
    [
        ("current_A", "heat_sink_warmup", "current_A: missing"),
        ("resistance_ohm", "film_lag", "resistance_ohm: missing"),
        ("meter_current_A", "self_heating", "meter_current_A: missing"),
        ("", "no_such_effect", "no effect"),
        ("", "thermometer_quantization", "needs no assumption"),
    ],
)
def test_what_the_record_cannot_have_is_refused(lagging: Columns, without: str, name: str, said: str) -> None:
    columns = {key: values for key, values in lagging.items() if key != without}
    with pytest.raises(ValueError, match=said) as raised:
        diagnose(columns, assume={name: {}})
    assert str(raised.value).startswith(name)


def ticking(step_s: float) -> Iterator[float]:
    """A clock that goes on by so much each time that somebody looks."""
    return (step_s * k for k in count())


def test_out_of_time_is_said_and_the_best_so_far_reported(lagging: Columns) -> None:
    clock = ticking(1.0)
    found = diagnose(lagging, budget_s=3.0, clock=lambda: next(clock))
    (told,) = [w.text for w in found.warnings if w.code == "out_of_time"]
    assert told.startswith("the search was ended by its budget of 3 s")
    assert {finding.name for finding in found.findings} <= {"sensor_lag"}
    assert found.verdict != "clean"  # of effects that were not tried it knows nothing
    assert all(np.isfinite(c.rmse_extended) for c in found.channels.values() if c is not None)


def test_a_budget_needs_a_clock(lagging: Columns) -> None:
    with pytest.raises(ValueError, match="budget_s: needs a clock"):
        diagnose(lagging, budget_s=60.0)
