"""Tuples of numbers and arrays of the same numbers, in Python and in compiled loops."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit

from compensator.control.packing import flattener, numbers_of, packed, rebuilder, unpacked
from compensator.hysteresis.functions import Array


class Pair(NamedTuple):
    one: float
    two: float


class Whole(NamedTuple):
    first: float
    pair: Pair
    array: Array
    last: float
    other: Any = None


Numbers = numbers_of(Whole, "Numbers", __name__)
VALUE = Whole(1.0, Pair(2.0, 3.0), np.arange(2.0), 4.0, "kept")


def test_there_and_back_in_python() -> None:
    flat = flattener(Whole)(VALUE)
    assert flat == (1.0, 2.0, 3.0, 4.0)
    back = rebuilder(Whole)([5.0, 6.0, 7.0, 8.0], VALUE.array, "other")
    assert back == Whole(5.0, Pair(6.0, 7.0), VALUE.array, 8.0, "other")
    assert isinstance(back.pair, Pair)
    assert Numbers._fields == ("first", "pair", "last")


def test_there_and_back_in_a_compiled_loop() -> None:
    @njit
    def doubled(array: Array) -> Array:
        whole = unpacked(array, Numbers)
        return packed(Numbers(2.0 * whole.first, Pair(whole.pair.two, whole.pair.one), 2.0 * whole.last), array.size)

    assert doubled(np.array([1.0, 2.0, 3.0, 4.0])) == pytest.approx([2.0, 3.0, 2.0, 8.0])
