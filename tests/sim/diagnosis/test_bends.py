"""The same bend of a reading, softer and sharper."""

from __future__ import annotations

import numpy as np
import pytest

from sim.effects.catalogue import catalogue
from sim.effects.effect import Reading
from sim.model.sharpness import of_sharpness

OHM = np.geomspace(1e2, 1e7, 40)
SIZES = {"series_resistance": 300.0, "parallel_leakage": 2e5}


def read(name: str, power: float) -> np.ndarray:
    form = of_sharpness(catalogue()[name], power).form
    assert isinstance(form, Reading)
    return form.read(np.array([SIZES[name]]), OHM)


@pytest.mark.parametrize("name", SIZES)
def test_at_one_it_is_the_effect(name: str) -> None:
    form = catalogue()[name].form
    assert isinstance(form, Reading)
    np.testing.assert_allclose(read(name, 1.0), form.read(np.array([SIZES[name]]), OHM), rtol=1e-12)


@pytest.mark.parametrize("name", SIZES)
def test_a_softer_one_reaches_further_and_a_sharper_one_less(name: str) -> None:
    away = {power: np.abs(np.log10(read(name, power) / OHM)) for power in (0.4, 1.0, 2.5)}
    assert np.all(away[0.4] > away[1.0])
    assert np.all(away[1.0] > away[2.5])
    for power in away:  # all of them end in the same: the size alone
        end = read(name, power)[0 if name == "series_resistance" else -1]
        assert 1.0 < max(end / SIZES[name], SIZES[name] / end) < 4.0 ** (1.0 / power)
