"""What a measured path is off by: its covariance, what a film shows of it, and its share of what a film leaves."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.diagnosis.data.path_error import PathError, SeenPathError
from sim.diagnosis.diagnose import diagnose
from tests.diagnosis.test_noisy_path import FINE_S, NOISE_DEC, NOISE_K, ROW_S, course, film

Array = NDArray[np.float64]
ROWS, READ_K = 120, 0.012


def walked() -> tuple[Array, NDArray[np.bool_], Array, Array]:
    """Rows, which of them were read, the rate's walk between them, and the path's covariance given all readings: from
    the inverse of the whole precision, (rows, rows)."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.5, 3.0, ROWS))
    read, density = rng.random(ROWS) < 0.9, 10.0 ** rng.uniform(-4.0, -2.0, ROWS - 1)
    read[[0, -1]] = True
    precision = np.zeros((2 * ROWS, 2 * ROWS))
    for k, dt in enumerate(np.diff(time)):
        walk = density[k] * READ_K**2 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        along = np.zeros((2, 2 * ROWS))
        along[:, 2 * k : 2 * k + 4] = [[-1.0, -dt, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]]
        precision += along.T @ np.linalg.inv(walk) @ along
    precision[::2, ::2] += np.diag(read / READ_K**2)
    return time, read, density, np.asarray(np.linalg.inv(precision)[::2, ::2], dtype=np.float64)


def test_what_a_path_is_off_by() -> None:
    time, read, density, covariance = walked()
    error = PathError.of(time, read, density, READ_K, np.empty(0, dtype=np.int64))
    assert error.deviation_K == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)


def test_what_a_film_shows_of_it_is_made_independent() -> None:
    """Beside an ohmmeter's noise of which rows share a part, a rough part of the path, and turns, in some of the rows:
    the quadratic form and the determinant are those of the whole covariance."""
    time, read, density, covariance = walked()
    rng, apart = np.random.default_rng(2), np.abs(np.subtract.outer(np.arange(ROWS), np.arange(ROWS)))
    turns = np.array([20, 55, 90])
    error = PathError.of(time, read, density, READ_K, turns)
    per_K, of_turns = rng.uniform(0.0, 0.5, ROWS), 1e-3 * rng.standard_normal((ROWS, turns.size))
    seen = SeenPathError(error, per_K, of_turns).rougher(0.004, 0.7)
    rows, noise = np.sort(rng.choice(ROWS, 80, replace=False)), rng.uniform(5e-4, 2e-3, ROWS)
    z = seen.whitening(rows, noise[rows], 0.5, 0.9)
    off_K = np.sqrt(np.diag(covariance) + 0.004**2) / np.sqrt(np.diag(covariance))
    together = 0.004**2 * 0.7**apart + covariance
    whole = per_K[:, None] * together * per_K + noise[:, None] * (0.9 * 0.5**apart + 0.1 * np.eye(ROWS)) * noise
    moved = of_turns * off_K[turns]
    whole = (whole + moved @ moved.T)[np.ix_(rows, rows)]
    values = rng.standard_normal((rows.size, 3)) * 1e-3
    over = z.over(values)
    assert over.T @ over == pytest.approx(values.T @ np.linalg.solve(whole, values), rel=1e-6, abs=1e-6)
    expected = -0.5 * float(values[:, 0] @ np.linalg.solve(whole, values[:, 0])) - 0.5 * np.linalg.slogdet(whole)[1]
    assert z.log_likelihood(values[:, 0]) == pytest.approx(expected, abs=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_a_noisy_thermometer_is_no_fault_of_the_film(seed: int) -> None:
    """And the ohmmeter's noise is told beside it, though on the flank it is a fortieth of what the thermometer's does
    there."""
    rng, degC = np.random.default_rng(1000 + seed), course(seed)
    rows = np.arange(0, degC.size, round(ROW_S / FINE_S))
    noise_K = NOISE_K * rng.standard_normal(rows.size)
    output = film(degC)[rows] + NOISE_DEC * rng.standard_normal(rows.size)
    found = diagnose(
        {"time_s": rows * FINE_S, "temperature_degC": degC[rows] + noise_K, "resistance_ohm": 10.0**output}
    )
    assert found.verdict == "clean"
    channel = found.channels["resistance_dec"]
    assert channel is not None
    assert channel.noise == pytest.approx(NOISE_DEC, rel=0.35)


@pytest.mark.long
def test_delays_that_noise_does_not_tell_apart_are_told() -> None:
    """A skew of 2 s is named, or is among what the named lag cannot be told from."""
    rng, degC = np.random.default_rng(1003), course(3)
    rows, fine_s = np.arange(0, degC.size, round(ROW_S / FINE_S)), np.arange(degC.size) * FINE_S
    output = np.interp(fine_s - 2.0, fine_s, film(degC))[rows]
    noise_K = NOISE_K * rng.standard_normal(rows.size)
    found = diagnose(
        {
            "time_s": rows * FINE_S,
            "temperature_degC": degC[rows] + noise_K,
            "resistance_ohm": 10.0 ** (output + NOISE_DEC * rng.standard_normal(rows.size)),
        }
    )
    (one,) = found.findings
    assert found.verdict == "explained"
    assert "timestamp_skew" in {one.name, *one.indistinguishable_from}
    assert next(iter(one.parameters.values()))[0] == pytest.approx(2.0, abs=0.2)
