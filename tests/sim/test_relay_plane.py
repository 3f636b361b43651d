"""The plane of relays: what it has about a single loop, and about a record with minor loops."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.fit.preisach_density import MINOR_LOOPS, ONE_LOOP, Extent, RelayPlane
from sim.model.film_nodes import FilmNodes

ENDS_DEGC = (20.0, 95.0)


def over(extent: Extent) -> RelayPlane:
    return RelayPlane.over(64.0, 25.0, ENDS_DEGC, 200, extent)


def test_of_a_single_loop_everything_that_switches_may_be_there_and_nothing_else() -> None:
    plane = over(ONE_LOOP)
    on, off = plane.centre_degC + plane.half_width_K, plane.centre_degC - plane.half_width_K
    assert np.all(on <= ENDS_DEGC[1])
    assert np.all(off >= ENDS_DEGC[0])
    assert float(np.max(plane.half_width_K)) > 0.4 * (ENDS_DEGC[1] - ENDS_DEGC[0])
    assert plane.count == np.linalg.matrix_rank(plane.mix)  # no column is there for nothing


def test_with_minor_loops_they_are_as_wide_as_a_loop_may_be() -> None:
    plane = over(MINOR_LOOPS)
    assert float(np.max(plane.half_width_K)) == pytest.approx(0.2 * (ENDS_DEGC[1] - ENDS_DEGC[0]))
    assert plane.count == 100  # two readings each


@pytest.mark.parametrize("extent", [MINOR_LOOPS, ONE_LOOP])
def test_the_signal_is_the_columns_times_their_coefficients(extent: Extent) -> None:
    """Also where a trial's plate has run away, to either side."""
    rng, rows = np.random.default_rng(1), np.arange(400)
    film_degC = 60.0 + 34.0 * np.sin(rows / 9.0) * np.linspace(1.0, 0.1, rows.size)
    film_degC[[200, 300]] = 1e30, -np.inf
    side = np.append(-2, np.sign(np.diff(film_degC))).astype(np.int8)
    nodes = FilmNodes(0.5 * rows, film_degC, side, rows, None, rows, rows)
    plane = over(extent)
    coefficients = rng.standard_normal(plane.count)
    step = float(np.max(np.abs(plane.mix @ coefficients)))
    signal = plane.signal(nodes, coefficients)
    np.testing.assert_allclose(signal, plane.columns(nodes) @ coefficients, atol=1e-4 * step)
    assert float(np.ptp(signal)) > 10.0 * step
