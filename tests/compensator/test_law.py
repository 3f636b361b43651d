"""The control law: its state is a value, what it cannot reach is said, what it lacks is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import PidGains
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import THIRTY_OPERATORS as FILM

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)


def full() -> Law:
    return Law(LawSettings("full", 0.1, 4.0, 10.0, 95.0, PidGains(1.2, 0.3, 1.0)), PLATE, FILM)


def test_the_state_is_a_value() -> None:
    law = full()
    state = law.start(50.0, None)
    targets = np.full(8, -2.9)
    targets.setflags(write=False)
    inputs = Inputs(50.1, -3.4, -2.9, targets)
    first, again = law.step(state, inputs), law.step(state, inputs)
    assert first[0] == again[0]
    for one, other in zip(first[1], again[1], strict=True):
        assert np.array_equal(np.ravel(flat(one)), np.ravel(flat(other)), equal_nan=True)
    for plays in (first[1].plays, first[1].memory.plays, state.plays):
        with pytest.raises(ValueError, match="read-only"):
            plays[0] = 0.0
    with pytest.raises(AttributeError):
        first[1].current_A = 1.0  # type: ignore[misc]


def flat(part: object) -> list[float]:
    """All numbers of a part of a state, in order."""
    if isinstance(part, tuple):
        return [number for each in part for number in flat(each)]
    return [] if part is None else list(np.ravel(np.asarray(part, dtype=np.float64)))


def test_an_output_that_cannot_be_reached_is_told() -> None:
    law = full()
    command, _ = law.step(law.start(50.0, None), Inputs(50.0, math.nan, -20.0, np.full(8, -20.0)))
    assert not command.reachable
    assert law.start(50.0, None).integral == 0.0


def test_a_law_of_the_resistance_needs_a_film() -> None:
    with pytest.raises(ValueError, match="film model"):
        Law(LawSettings("full", 0.1, 4.0, 10.0, 95.0, PidGains(1.0, 0.1)), PLATE, None)
