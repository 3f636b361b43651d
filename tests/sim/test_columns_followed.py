"""Filters of many columns at once are what each column's filter is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.effects.catalogue import catalogue
from sim.effects.effect import Filter, Switched
from sim.model.links import columns_followed

WITH_COLUMNS = [e for e in catalogue().values() if isinstance(e.form, Filter) and e.form.columns is not None]


@pytest.mark.parametrize("effect", WITH_COLUMNS, ids=lambda e: e.name)
@pytest.mark.parametrize("tau_s", [0.0, 0.2, 300.0])
def test_to_the_bit(effect: object, tau_s: float) -> None:
    """Uneven times, two nodes at one of them, and a filter that is none."""
    assert isinstance(effect, type(WITH_COLUMNS[0]))
    assert isinstance(effect.form, Filter)
    rng = np.random.default_rng(1)
    time_s = np.cumsum(rng.choice([0.0, 0.1, 0.1, 0.3], 500))
    columns = np.cumsum(rng.standard_normal((500, 7)), axis=0)
    par = np.array([tau_s if p.name == "tau_s" else 0.1 for p in effect.parameters])
    one_by_one = replace(effect, form=replace(effect.form, columns=None))
    together = columns_followed(Switched(effect, par), time_s, columns)
    np.testing.assert_array_equal(together, columns_followed(Switched(one_by_one, par), time_s, columns))


def test_the_film_and_the_ohmmeter_have_some() -> None:
    assert {e.name for e in WITH_COLUMNS} == {"creep", "meter_lag"}
