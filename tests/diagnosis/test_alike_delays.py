"""Of delays that a record cannot tell apart the same one is said, whatever the last digit of its readings is."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from tests.diagnosis.cases import case


@pytest.mark.parametrize("moved", [0.0, 1e-12])
def test_the_simplest_of_delays_that_show_the_same_is_said(moved: float) -> None:
    """A steady ramp: a skew was said of it as it is, a lag of the ohmmeter of the same moved by 1e-12."""
    blind = case("indistinguishable", 105016)
    rng = np.random.default_rng(blind.seed)
    columns = {
        name: values * (1.0 + moved * rng.standard_normal(values.size)) if name.endswith(("_degC", "_ohm")) else values
        for name, values in blind.columns.items()
    }
    (said,) = diagnose(columns, **blind.options).document()["effects"]
    assert said["name"] == "timestamp_skew"
    assert set(said["indistinguishable_from"]) == {"film_lag", "meter_lag"}
