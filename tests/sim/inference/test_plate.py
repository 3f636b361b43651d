"""Identification of plates: parameters, error bars, gaps, outliers, and what a record leaves open."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from compensator.thermal.plate import SEEBECK_SLOPE_PRIOR_PER_K, PlateModel
from sim.inference.plate.fit import PlateFit, PlateRecord, identify_plate, identify_plate_records

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 24.0)
TRUTH = np.array([1.6e-3, 0.06, 0.018, 24.0])
MEASURED = Path(os.environ.get("PELTIER_DATA", Path(__file__).parents[3] / "shared" / "data"))


def profile(length_s: float = 1500.0) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, length_s, 0.5)
    corners = [0, 200, 201, 400, 401, 700, 701, 900, 901, 1100, 1101, 1500]
    levels = [2, 2, -1, -1, 3, 3, 0.5, 0.5, -2, -2, 1.5, 1.5]
    return time, np.interp(time, corners, levels) + 0.5 * np.sin(time / 30.0)


def test_parameters_and_their_error_bars() -> None:
    time, current = profile()
    clean = PLATE.simulate(24.0, time, current)
    inside = []
    for seed in range(25):
        fit = identify_plate(time, clean + 0.01 * np.random.default_rng(seed).normal(size=time.size), current)
        assert np.allclose(fit.values[:4], TRUTH, rtol=1e-3)
        inside.append(np.abs(fit.values - np.append(TRUTH, (0.0, 0.0))) < 1.96 * fit.standard_errors)
    assert np.mean(inside) > 0.85
    assert fit.rmse_K == pytest.approx(0.01, rel=0.1)
    assert fit.noise_K == pytest.approx(0.01, rel=0.2)
    assert fit.first_degC[0] == pytest.approx(24.0, abs=0.01)
    assert fit.identifiability == ()
    assert fit.correlation.shape == (6, 6)


@pytest.mark.parametrize("lag_s", [0.0, 0.5, 5.0, 30.0])
def test_a_thermometer_that_lags(lag_s: float) -> None:
    """The lag comes back with the plate, by fine steps that share nothing with the fit; without a lag there is none."""
    time, current = profile()
    plate, shown, readings = 24.0, 24.0, []
    for amount in current:
        readings.append(shown)
        for _ in range(20):
            plate += 0.025 * PLATE.rate_K_per_s(plate, float(amount))
            shown = shown + 0.025 * (plate - shown) / lag_s if lag_s else plate
    noise = 0.01 * np.random.default_rng(5).normal(size=time.size)
    fit = identify_plate(time, np.array(readings) + noise, current, lag=True)
    assert fit.lag_s == pytest.approx(lag_s, rel=0.02, abs=0.03)
    assert np.allclose(fit.values[:4], TRUTH, rtol=0.01)


def test_without_noise_the_plate_comes_back() -> None:
    time, current = profile(700.0)
    fit = identify_plate(time, PLATE.simulate(31.0, time, current), current)
    assert np.allclose(fit.values[:4], TRUTH, rtol=1e-6)
    assert fit.first_degC[0] == pytest.approx(31.0, abs=1e-6)


def test_outliers_missing_readings_and_a_gap() -> None:
    time, current = profile()
    readings = PLATE.simulate(24.0, time, current) + 0.01 * np.random.default_rng(0).normal(size=time.size)
    readings[500] += 20.0
    readings[700:704] -= 3.0
    readings[1000:1100] = np.nan
    keep = (time < 900.0) | (time > 960.0)
    time, readings, current = time[keep], readings[keep], current[keep]
    fit = identify_plate(time, readings, current)
    assert np.allclose(fit.values[:4], TRUTH, rtol=2e-3)
    assert len(fit.first_degC) == 2
    assert fit.outliers >= 1


def test_a_heater_and_several_records() -> None:
    heater = PlateModel(0.0, 0.0, 0.02, 22.0, 0.8, "heater")
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 400.0, 1.0)
    records = []
    for first, levels in ((22.0, [0.0, 1.0, 0.3]), (40.0, [0.5, 0.0, 0.8])):
        drive = np.repeat(levels, 134)[:400]
        readings = heater.simulate(first, time, drive) + 0.02 * rng.normal(size=400)
        records.append(PlateRecord(time, readings, drive))
    fit = identify_plate_records(records, kind="heater")
    assert fit.model.kind == "heater"
    assert np.allclose(fit.values, [0.8, 0.02, 22.0], rtol=5e-3)
    assert fit.first_degC == pytest.approx((22.0, 40.0), abs=0.05)


def test_what_a_record_leaves_open_is_told_and_stays_plausible() -> None:
    time, _ = profile()
    current = np.full(time.size, 2.0)
    readings = PLATE.simulate(24.0, time, current) + 0.01 * np.random.default_rng(2).normal(size=time.size)
    fit = identify_plate(time, readings, current)
    assert any("constant" in note for note in fit.identifiability)
    assert not np.all(np.isfinite(fit.standard_errors))
    assert fit.rmse_K < 0.011
    assert -10.0 < fit.model.ambient_degC < 60.0
    assert fit.model.seebeck_over_capacity_per_A_s > 1e-5
    one_sign = identify_plate(time, PLATE.simulate(24.0, time, 1 + np.sin(time / 80)), 1 + np.sin(time / 80))
    assert any("one sign" in note for note in one_sign.identifiability)


def test_a_current_of_the_other_sign_is_told() -> None:
    time, current = profile(1000.0)
    readings = PLATE.simulate(24.0, time, current) + 0.01 * np.random.default_rng(0).normal(size=time.size)
    fit = identify_plate(time, readings, -current)
    assert fit.far_off
    assert "something is missing" in fit.identifiability[0]
    assert "the sign may be turned" in fit.identifiability[0]
    assert not any("usual" in note for note in fit.identifiability)
    heater = identify_plate(time, readings, np.abs(current) / 4.0, kind="heater")
    assert "something is missing" in heater.identifiability[0]


def test_a_number_that_is_not_determined_is_called_one_of_many() -> None:
    time, _ = profile()
    current = np.full(time.size, 2.0)
    fit = identify_plate(time, PLATE.simulate(24.0, time, current), current)
    ambient = fit.values[fit.names.index("ambient_degC")]
    told = [note for note in fit.identifiability if "not determined" in note]
    assert any(note.startswith("ambient_degC") and f"{ambient:.3g}" in note for note in told)
    assert all("one of many values" in note for note in told)


def test_unusable_records_are_refused_in_one_line() -> None:
    time, current = profile(100.0)
    readings = PLATE.simulate(24.0, time, current)
    cases = [
        (time[::-1], readings, current, "increasing"),
        (time, np.full(time.size, np.nan), current, "finite readings"),
        (time, readings, np.zeros(time.size), "0 throughout"),
        (time, np.full(time.size, 25.0), current, "temperature_degC: constant at 25, expected one that follows"),
        (time, readings, np.full(time.size, np.nan), "current_A"),
        (time[:-1], readings, current, "same length"),
    ]
    for t, v, i, words in cases:
        with pytest.raises(ValueError, match=words) as caught:
            identify_plate(t, v, i)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="kind"):
        identify_plate(time, readings, current, kind="oven")


def test_measured_plates() -> None:
    file = MEASURED / "peltier_8010.csv"
    if not file.is_file():
        pytest.skip(f"{file}: not there (PELTIER_DATA)")
    table = np.genfromtxt(file, delimiter=",", skip_header=1)
    fit = identify_plate(*table.T)
    assert fit.rmse_K < 1.2
    assert fit.noise_K == pytest.approx(0.2, abs=0.1)
    step = np.genfromtxt(MEASURED / "heater_step.csv", delimiter=",", skip_header=1)
    heater = identify_plate(step[:, 0], step[:, 2] - 273.15, step[:, 1] / 255.0, kind="heater")
    assert heater.rmse_K < 1.6


def test_by_how_much_a_model_is_off_beyond_the_noise() -> None:
    """White noise: by nothing. An error that comes and goes: its size and for how long."""
    time, current = profile()
    rng, clean = np.random.default_rng(3), PLATE.simulate(24.0, time, current)
    white = 0.01 * rng.normal(size=time.size)
    assert identify_plate(time, clean + white, current).model.error_K == 0.0
    slow, rate, length = np.zeros(time.size), 0.0, 10.0  # x'' = -2 x' / l - x / l^2 + noise, in fine steps
    x, dt = 0.0, 0.05
    for k in range(10 * time.size):
        rate += dt * (-2.0 * rate / length - x / length**2) + 0.05 * 2.0 * length**-1.5 * np.sqrt(dt) * rng.normal()
        x += dt * rate
        slow[k // 10] = x
    found = identify_plate(time, clean + white + slow, current)
    assert 0.03 < found.model.error_K < 0.08
    assert 10.0 < found.model.error_time_s < 40.0  # twice the length
    assert found.noise_K == pytest.approx(0.01, rel=0.1)


def _driven(model: PlateModel, current: np.ndarray, acts: np.ndarray) -> PlateFit:
    time = 0.5 * np.arange(current.size)
    noise = 0.01 * np.random.default_rng(1).normal(size=current.size)
    return identify_plate(time, model.simulate(25.0, time, acts) + noise, current)


def _steps(seed: int = 1) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(0.0, 1.5, 16), 100)


def test_a_heater_fitted_as_a_peltier_plate_is_told_to_be_one() -> None:
    current = _steps()
    heater = _driven(PlateModel(0.0, 0.0, 0.018, 25.0, 0.9, "heater"), current, current)
    (note,) = [note for note in heater.identifiability if "--plate heater" in note]
    assert "leaves 0.01 K (RMS), a Peltier plate's 0.02" in note
    peltier = _driven(PlateModel(1.6e-3, 0.06, 0.018, 25.0), current, current)
    assert not any("heater" in note for note in peltier.identifiability)


@pytest.mark.parametrize("kind", ["heater", "peltier"])
def test_a_cooling_side_that_does_nothing_is_told(kind: str) -> None:
    current = np.where(np.arange(1600) % 400 < 200, _steps(), -0.5 * _steps())
    plate = PlateModel(0.0, 0.0, 0.018, 25.0, 0.9, "heater")
    plate = plate if kind == "heater" else PlateModel(1.6e-3, 0.06, 0.018, 25.0)
    unconnected = _driven(plate, current, np.maximum(current, 0.0))
    (note,) = [note for note in unconnected.identifiability if "Is the cooling side connected?" in note]
    assert ("--plate heater" in note) == (kind == "heater")
    if kind == "peltier":
        connected = _driven(plate, current, current)
        assert not any("connected" in note for note in connected.identifiability)


def test_measured_peltier_plates_are_no_heaters(measured: Path) -> None:
    for name in ("peltier_8010", "peltier_8020", "peltier_500", "peltier_runaway", "peltier_8052"):
        time, degC, duty = np.genfromtxt(measured / f"{name}.csv", delimiter=",", skip_header=1)[:, :3].T
        notes = identify_plate(time, degC, duty).identifiability
        assert not any("--plate heater" in note or "connected" in note for note in notes), name


def test_slopes_of_a_plate_come_back() -> None:
    """Bi2Te3's Seebeck coefficient and resistance grow with temperature; as constants they would move all else."""
    time, current = profile()
    plate = PlateModel(1.6e-3, 0.06, 0.018, 24.0, seebeck_slope_per_K=0.002, resistance_slope_per_K=0.005)
    readings = plate.simulate(24.0, time, current) + 0.01 * np.random.default_rng(4).normal(size=time.size)
    fit = identify_plate(time, readings, current)
    off = (fit.values - np.append(TRUTH, (0.002, 0.005))) / fit.standard_errors
    assert np.all(np.abs(off) < 3.0)
    assert fit.rmse_K == pytest.approx(0.01, rel=0.1)
    assert fit.model.seebeck_slope_per_K == pytest.approx(0.002, abs=2e-4)
    constant = identify_plate(time, readings, current, slopes=False)
    assert constant.rmse_K > 5.0 * fit.rmse_K
    assert constant.model.seebeck_slope_per_K == 0.0


def test_slopes_that_a_record_does_not_show_are_those_of_the_material() -> None:
    time = np.arange(0.0, 300.0, 0.5)
    current = np.repeat([0.2, -0.2, 0.1, 0.0, 0.15, -0.1], 100)
    readings = PLATE.simulate(24.0, time, current) + 0.01 * np.random.default_rng(6).normal(size=time.size)
    fit = identify_plate(time, readings, current)
    mean, deviation = SEEBECK_SLOPE_PRIOR_PER_K
    assert abs(fit.model.seebeck_slope_per_K - mean) < 2.0 * deviation
    assert 0.6 * deviation < fit.standard_errors[4] < 1.2 * deviation
    assert not any("slope" in note for note in fit.identifiability)


def test_readings_of_half_a_degree_tell_as_much_as_their_intervals() -> None:
    """A coarse thermometer's last digit is no fault of the plate's model, and no noise that widens its intervals."""
    time, current = profile()
    noisy = PLATE.simulate(24.0, time, current) + 0.05 * np.random.default_rng(7).normal(size=time.size)
    fine, coarse = identify_plate(time, noisy, current), identify_plate(time, 0.5 * np.round(2.0 * noisy), current)
    assert coarse.noise_K == pytest.approx(0.5 / np.sqrt(12.0), rel=0.1)
    assert not any("missing" in note for note in coarse.identifiability)
    assert np.all(np.abs(coarse.values - np.append(TRUTH, (0.0, 0.0))) < 3.0 * coarse.standard_errors)
    assert np.all(coarse.standard_errors < 2.6 * fine.standard_errors)  # taken for noise of 0.14 K: 2.9 and more


def test_records_of_two_days_have_rooms_of_their_own() -> None:
    """One room for both would be a misfit of kelvins, and move the plate's numbers."""
    time, current = profile()
    rng, records = np.random.default_rng(8), []
    for room in (24.0, 29.0):
        readings = PlateModel(1.6e-3, 0.06, 0.018, room).simulate(room, time, current)
        records.append(PlateRecord(time, readings + 0.01 * rng.normal(size=time.size), current))
    fit = identify_plate_records(records)
    assert fit.rmse_K == pytest.approx(0.01, rel=0.05)
    assert np.all(np.abs(fit.values - np.append(TRUTH, (0.0, 0.0))) < 3.0 * fit.standard_errors)
    assert [course.size for course in fit.course_degC] == [time.size, time.size]


def test_a_row_long_before_the_others_moves_nothing() -> None:
    """Logs begin with a row from before the controller ran, its current in it: the plate did not follow that."""
    time, current = profile()
    readings = PLATE.simulate(24.0, time, current) + 0.01 * np.random.default_rng(9).normal(size=time.size)
    one = identify_plate(time, readings, current)
    two = identify_plate(np.append(-5.0, time), np.append(27.0, readings), np.append(current[0], current))
    assert np.all(np.abs(two.values - one.values) < 0.1 * one.standard_errors)
