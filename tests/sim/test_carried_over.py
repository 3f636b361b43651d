"""What a fit misses in rows that it has not seen counts where the fitted rows tell the film, if they tell most."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from compensator.hysteresis.functions import Array
from sim.diagnosis.judge.carried_over import CarriedOver, carried_over
from sim.diagnosis.validate.held_out_rows import HeldOutRows

FILM = "resistance_dec"
ROWS = 400
NOISE_DEC = 0.002


class Rows:
    """Held-out rows of which a fit left so much, with so much left open by the fitted rows; decades, (rows,)."""

    def __init__(self, left_dec: Array, open_dec: Array) -> None:
        self.rows = np.ones(ROWS, dtype=np.bool_)
        self._left_dec, self._open_dec = left_dec, open_dec

    def left_everywhere(self, names: frozenset[str]) -> dict[str, Array]:
        return {FILM: self._left_dec}

    def noise(self, names: frozenset[str], with_path: bool = False) -> dict[str, float]:
        return {FILM: NOISE_DEC}

    def film_noise_dec(self) -> Array:
        return np.full(ROWS, NOISE_DEC)

    def film_left_open_dec(self, names: frozenset[str]) -> Array:
        return self._open_dec


def judged(missed_dec: float, left_open: slice, missed: slice) -> CarriedOver:
    """Rows missed by so much in one place, and left open by three times the noise in another."""
    left_dec = NOISE_DEC * np.random.default_rng(3).standard_normal(ROWS)
    left_dec[missed] += missed_dec
    open_dec = np.full(ROWS, 0.2 * NOISE_DEC)
    open_dec[left_open] = 3.0 * NOISE_DEC
    return carried_over(cast(HeldOutRows, Rows(left_dec, open_dec)), frozenset())


def test_what_is_missed_where_the_record_leaves_the_film_open_does_not_count() -> None:
    found = judged(0.04, slice(0, 80), slice(0, 80))
    assert found.not_counted == (80, ROWS)
    assert found.times[FILM] == pytest.approx(1.0, abs=0.1)


def test_what_is_missed_where_the_record_tells_counts() -> None:
    found = judged(0.04, slice(0, 80), slice(80, 160))
    assert found.not_counted == (0, 0)
    assert found.times[FILM] > 5.0


def test_nothing_is_left_out_where_most_of_the_rows_are_left_open() -> None:
    found = judged(0.04, slice(0, 240), slice(0, 240))
    assert found.not_counted == (0, 0)
    assert found.times[FILM] > 2.0


def test_nothing_is_left_out_of_what_is_missed_by_no_more_than_is_foreseen() -> None:
    found = judged(5.0 * NOISE_DEC, slice(0, 80), slice(0, 80))
    assert found.not_counted == (0, 0)
    assert found.expected[FILM] > NOISE_DEC
    assert found.times[FILM] < 2.0
