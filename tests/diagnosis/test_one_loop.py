"""One sparse loop of a film whose branches are shifted copies: held-out rows are told, and nobody is blamed."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose


def grains(degC: np.ndarray) -> np.ndarray:
    """log10 R of grains in parallel: steep towards the metal, flat towards the insulator."""
    share = 1.0 / (1.0 + np.exp(-(degC - 65.0) / 1.6))
    conductance = 1e-6 + 0.015 * share**3 + 2e-5 * share
    return np.asarray(-np.log10(conductance))


@pytest.fixture(scope="module")
def said() -> dict[str, object]:
    rng = np.random.default_rng(2)
    up = np.arange(40.0, 95.0, 0.6)
    degC = np.concatenate((up[::-1], up[1:]))
    rising = np.arange(degC.size) >= up.size
    log_ohm = grains(degC - np.where(rising, 2.5, -2.5)) - 0.012 * (degC - 65.0)
    noise_dec = np.where(log_ohm > 3.5, 3e-5, 8e-4)
    log_ohm = log_ohm + noise_dec * rng.standard_normal(degC.size)
    time_s = 4.6 * np.arange(degC.size)
    columns = {"time_s": time_s, "temperature_degC": degC, "resistance_ohm": 10.0**log_ohm}
    return diagnose(columns).document()


def test_nobody_is_blamed(said: dict[str, object]) -> None:
    assert said["effects"] == []
    assert said["verdict"] in ("too_short", "clean")


def test_no_reading_is_left_out_for_what_a_model_is_off_by(said: dict[str, object]) -> None:
    rules = {left["rule"] for left in said["rows"]["left_out"]}  # type: ignore[index]
    assert not any("neighbours" in rule for rule in rules)


def test_held_out_rows_are_told(said: dict[str, object]) -> None:
    assert said["channels"]["resistance_dec"]["rmse_extended"] < 0.02  # type: ignore[index]
