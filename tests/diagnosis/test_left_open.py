"""What the fitted rows leave open of a film is no fault of the model where a record goes elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cho_solve

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.search.both_ends import select
from sim.diagnosis.search.chain import Chain, temperature_search
from sim.diagnosis.validate.left_open import film_left_open
from tests.diagnosis.cases import case


def test_it_is_that_of_the_fits_covariance() -> None:
    """Of its own rows, and of the same rows as those of another record."""
    record = read_columns(case("clean", 3, rows=400).columns)
    first = temperature_search(record, {})
    chain, names = select(Chain(record, {}, first, as_read=record), lambda text: None)
    b = chain.fits(names)[1]
    assert b is not None
    point = chain.film_channel(names).point(b.parameters, b.parameters.x, b.coefficients)
    columns = np.concatenate((point.problem.at_rows, point.problem.relays.every), axis=1)
    exact = np.sqrt(np.sum(columns * cho_solve(point.factor, columns.T).T, axis=1))
    own = film_left_open(chain, names)
    assert np.median(own / exact) == pytest.approx(1.0, abs=0.2)
    np.testing.assert_allclose(film_left_open(chain, names, record)[20:], own[20:], rtol=0.3)


@pytest.mark.long
@pytest.mark.parametrize("seed", [97000, 97008])
def test_a_record_that_goes_elsewhere_leaves_a_clean_one_clean(seed: int) -> None:
    """Held-out rows are 2.5 and 4.2 times off the noise, which is a ten-thousandth of a decade."""
    made = case("real_noise", seed)
    assert made.holdout is not None
    assert diagnose(made.columns, holdout=[made.holdout]).verdict == "clean"
