"""Records that no model explains: rows count for what they say, and a plate keeps to what plates are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compensator.thermal.plate import PlateModel
from rig.analysis.diagnosed import model_of
from rig.analysis.predicted import predicted
from rig.config.model_file import read_model, write_model
from rig.records.record_file import ColumnMapping, Record, read_record
from sim.diagnosis.data.misfit import misfit_of
from sim.diagnosis.data.record import read_columns
from sim.diagnosis.data.segments import first_rows, gaps
from sim.diagnosis.extended_model import ExtendedModel
from sim.diagnosis.judge.plate_kind import of_no_kind
from sim.diagnosis.report.row_warnings import row_warnings
from sim.diagnosis.search.chain import Chain, temperature_search
from sim.diagnosis.search.temperature_search import beside_misfit
from sim.diagnosis.validate.held_out import residuals_on
from sim.effects.catalogue import catalogue
from sim.inference.nuisance import told_rows
from sim.model.recorded import driven_rows

PLATE = ("time_s=t_s|time@s", "temperature_degC=T_C|temp@degC", "current_A=duty|output@duty")
NAMES = frozenset({"heat_sink_warmup", "sensor_lag"})
ROWS = 20_000


def test_white_rows_count_as_one_each() -> None:
    assert misfit_of(np.random.default_rng(1).standard_normal(ROWS)) < 1.5


@pytest.mark.parametrize(("rho", "size"), [(0.8, 1.0), (0.5, 3.0)])
def test_rows_that_hang_together_count_less(rho: float, size: float) -> None:
    """Of a first-order autoregression tau is (1 + rho) / (1 - rho)."""
    rng, z = np.random.default_rng(2), np.zeros(ROWS)
    for k in range(1, ROWS):
        z[k] = rho * z[k - 1] + size * np.sqrt(1.0 - rho * rho) * rng.standard_normal()
    assert misfit_of(z) == pytest.approx(size * size * (1.0 + rho) / (1.0 - rho), rel=0.25)


@pytest.mark.parametrize(("after_A", "begins"), [(1.0, [0]), (0.4, [0, 1])])
def test_a_held_command_goes_on_through_a_gap(after_A: float, begins: list[int]) -> None:
    """A first step of eight others, as of a log that starts while a controller has begun to heat."""
    time = np.concatenate(([0.0], 5.0 + 0.62 * np.arange(200.0)))
    current = np.where(time < 1.0, 1.0, after_A)
    told = np.ones(time.size, dtype=np.bool_)
    degC = 30.0 + 0.1 * time + 0.05 * np.random.default_rng(3).standard_normal(time.size)
    assert first_rows(time, degC, current, told, gaps(time, told)).tolist() == begins


def test_rows_at_rest_are_not_in_doubt() -> None:
    current = np.array([0.0] * 30 + [1.0] * 30)
    columns = {"time_s": np.arange(60.0), "temperature_degC": 20.0 + 0.01 * np.arange(60.0), "current_A": current}
    driven = driven_rows(read_columns(columns))
    assert not np.any(driven[:31])
    assert np.all(driven[31:])


def test_an_error_is_kept_in_a_model_file(tmp_path: Path) -> None:
    model = model_of(ExtendedModel(None, PlateModel(1e-3, 0.1, 0.02, 25.0, error_K=0.9), [], None))
    write_model(tmp_path / "model.toml", model)
    again = read_model(tmp_path / "model.toml")
    assert again.plate == model.plate


def test_a_measured_sink_saturates(measured: Path) -> None:
    record = read_columns(_run(measured, "runaway").columns)
    (warning,) = (found for found in row_warnings(record) if found.code == "heat_sink_saturated")
    assert warning.from_s is not None
    assert warning.to_s is not None
    assert 340.0 < warning.from_s < warning.to_s < 520.0


def _run(folder: Path, name: str) -> Record:
    return read_record(folder / f"peltier_{name}.csv", [ColumnMapping.parse(text) for text in PLATE])


@pytest.mark.long
def test_one_run_of_a_real_plate_tells_of_another(measured: Path) -> None:
    """2.7 K and a room at -15 degC where each row counts as one."""
    one, other = _run(measured, "80510"), _run(measured, "8052")
    record = read_columns(one.columns, held_out=False).commanded_in_sight(catalogue().values())
    search = temperature_search(record, catalogue())
    first = beside_misfit(search, NAMES)
    assert first is not None
    fit = first.fit(NAMES)
    assert 10.0 < fit.parameters.plate()[4] < 40.0
    for effect in fit.effects:
        assert all(v <= p.largest for p, v in zip(effect.effect.parameters, effect.par, strict=True))
    chain = Chain(record, catalogue(), first=first)
    rows = read_columns(other.columns, held_out=False).commanded_in_sight(catalogue().values())
    error_K = float(np.sqrt(np.nanmean(residuals_on(chain, NAMES, rows, told_rows(rows))["temperature_K"] ** 2)))
    assert error_K < 0.9
    s, r, g, _, room = (float(v) for v in fit.parameters.plate())
    plate = PlateModel(s, r, g, room, error_K=first.channel.error_K)
    tables: list[dict[str, float | str]] = [{"name": e.name, **e.values()} for e in fit.effects]
    alone = predicted(model_of(ExtendedModel(None, plate, tables, None)), other, "model", initial="fitted")
    assert alone.temperature_degC is not None
    left = (alone.temperature_degC - other["temperature_degC"])[~alone.fitted_rows]
    assert float(np.sqrt(np.nanmean(left**2))) == pytest.approx(error_K, rel=0.05)


@pytest.mark.parametrize(("power", "pumps"), [(2.0, False), (1.0, True)])
def test_heat_with_the_square_of_a_drive_is_of_no_kind(power: float, pumps: bool) -> None:
    """A lamp's voltage: a Peltier plate that pumps nothing fits it best. What is linear in its drive may be either."""
    rng = np.random.default_rng(4)
    drive, degC = np.repeat(rng.uniform(0.2, 1.0, 30), 20), np.empty(600)
    plate = 25.0
    for k in range(degC.size):
        degC[k] = plate + 0.05 * rng.standard_normal()
        for _ in range(50):
            plate += (1.2 * drive[k] ** power - 0.02 * (plate - 25.0)) / 50.0
    record = read_columns({"time_s": np.arange(600.0), "temperature_degC": degC, "current_A": drive}, held_out=False)
    first = temperature_search(record, catalogue(), ("peltier", "heater"))
    chain = Chain(record, catalogue(), first=first)
    assert of_no_kind(chain, frozenset()) is not pumps
