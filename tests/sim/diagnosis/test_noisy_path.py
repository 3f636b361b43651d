"""A film driven by a thermometer's noisy readings: a lag that is there is named, and what a lag smooths is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import norm

from sim.diagnosis.diagnose import diagnose

Array = NDArray[np.float64]
FINE_S, ROW_S = 0.2, 2.0
NOISE_K, NOISE_DEC = 0.012, 1e-4
TURNS_DEGC = (24.0, 82.0, 55.0, 75.0, 60.0, 69.0, 63.0, 78.0, 50.0, 66.0, 58.0, 72.0, 40.0)


def course(seed: int) -> Array:
    """The plate's temperature, a value each FINE_S: ramps at 0.07 K/s, corners rounded by a plate of 15 s."""
    rates = 0.07 * FINE_S * np.random.default_rng(seed).uniform(0.7, 1.3, len(TURNS_DEGC))
    parts = [
        np.linspace(a, b, math.ceil(abs(b - a) / rate))
        for a, b, rate in zip(TURNS_DEGC, TURNS_DEGC[1:], rates, strict=False)
    ]
    ramps = np.concatenate(parts) - TURNS_DEGC[0]
    keeps = math.exp(-FINE_S / 15.0)
    return np.asarray(TURNS_DEGC[0] + lfilter([1.0 - keeps], [1.0, -keeps], ramps))


def film(degC: Array) -> Array:
    """log10 R of 150 grains: half-widths about 3 K, each with a normal density of middles; phases mix in their logs."""
    half_K = 3.0 * np.exp(0.35 * norm.ppf((np.arange(150) + 0.5) / 150))
    play, metal = degC[0] + half_K, np.empty(degC.size)
    for k, now in enumerate(degC):
        np.clip(play, now - half_K, now + half_K, out=play)
        metal[k] = float(np.mean(norm.cdf((play - 66.0) / 2.5)))
    insulating = 5.0 + 0.2 / 8.617e-5 / math.log(10.0) * (1.0 / (degC + 273.15) - 1.0 / 333.15)
    return np.asarray((1.0 - metal) * insulating + metal * 2.0)


def lagged(values: Array, tau_s: float) -> Array:
    """Behind a first-order lag, of values that are straight between their points: exact."""
    a = FINE_S / tau_s
    keeps = math.exp(-a)
    now, before = 1.0 - (1.0 - keeps) / a, (1.0 - keeps) / a - keeps
    return np.asarray(values[0] + lfilter([now, before], [1.0, -keeps], values - values[0]))


def record(rng: np.random.Generator, degC: Array, log_ohm: Array) -> dict[str, Array]:
    """What thermometer and ohmmeter show, a row each ROW_S."""
    rows = np.arange(0, degC.size, round(ROW_S / FINE_S))
    return {
        "time_s": rows * FINE_S,
        "temperature_degC": degC[rows] + NOISE_K * rng.standard_normal(rows.size),
        "resistance_ohm": 10.0 ** (log_ohm[rows] + NOISE_DEC * rng.standard_normal(rows.size)),
    }


@pytest.mark.long
@pytest.mark.parametrize(("seed", "lag_s"), [(3, 4.0), (8, 1.5)])
def test_a_lag_that_is_there_is_named(seed: int, lag_s: float) -> None:
    """A smoother path does next to nothing of what it does, and a lag of the ohmmeter is another one."""
    rng, degC = np.random.default_rng(seed), course(seed)
    found = diagnose(record(rng, degC, film(lagged(degC, lag_s))))
    assert [f.name for f in found.findings] == ["film_lag"]
    assert found.findings[0].parameters["tau_s"][0] == pytest.approx(lag_s, rel=0.06)


@pytest.mark.long
def test_a_lag_that_another_is_taken_for_is_told_as_such() -> None:
    """In this record the ohmmeter's lag costs less by 22, where two fits of one film differ by more."""
    rng, degC = np.random.default_rng(6), course(6)
    found = diagnose(record(rng, degC, film(lagged(degC, 1.5))))
    assert len(found.findings) == 1
    assert "film_lag" in {found.findings[0].name, *found.findings[0].indistinguishable_from}


@pytest.mark.long
@pytest.mark.parametrize("seed", [6, 7])
def test_a_lag_of_the_ohmmeter_is_its_own(seed: int) -> None:
    rng, degC = np.random.default_rng(seed), course(seed)
    found = diagnose(record(rng, degC, lagged(film(degC), 1.5)))
    assert [f.name for f in found.findings] == ["meter_lag"]
    assert found.findings[0].parameters["tau_s"][0] == pytest.approx(1.5, rel=0.06)
