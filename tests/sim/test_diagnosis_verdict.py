"""What may be said: how much the rows that no fit has seen may speak against an effect."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.verdict import WEAK, may_lose


@pytest.mark.parametrize("expected", [0.3, 2.0, 8.0, 30.0])
def test_chance_takes_more_than_it_may_from_one_real_effect_in_twenty(expected: float) -> None:
    """An effect that is real gains what is expected of it on average, give or take the root of twice that."""
    rng = np.random.default_rng(7)
    gain = expected + np.sqrt(2.0 * expected) * rng.standard_normal(200_000)
    refused = np.mean(gain < -may_lose(WEAK - 1.0, expected))
    assert refused < 0.06 if expected < 3.0 else refused < 0.025
    wrong = -expected + np.sqrt(2.0 * expected) * rng.standard_normal(200_000)
    if expected > 5.0:
        assert np.mean(wrong < -may_lose(WEAK - 1.0, expected)) > 0.9


def test_much_evidence_may_lose_a_tenth() -> None:
    assert may_lose(200.0, 50.0) == pytest.approx(20.0)
    assert may_lose(10.0, 50.0) == 0.0
