"""predict and tracking with [[effects]] in the model; predictions of film records that lack rows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import rig
from rig.config.model_file import Model
from rig.records.conversion import record_from_arrays
from rig.records.record_file import read_record, write_columns
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench
from tests.sim.inference.identification_films import is_prandtl_ishlinskii
from tests.sim.inference.test_identify_gaps import NOISE, with_an_excursion

CURRENTS = '["start 1 A", "hold 20 s", "ramp to 2.5 A in 60 s", "ramp to -0.5 A in 60 s", "ramp to 1.5 A in 40 s"]'
EFFECTS = {
    "film_lag": {"tau_s": 3.0},
    "sensor_lag": {"tau_s": 2.0},
    "heat_sink_warmup": {"sink_capacity_ratio": 8.0, "sink_conductance_ratio_per_s": 0.1},
    "creep": {"share": 0.1, "tau_s": 100.0},
    "series_resistance": {"series_ohm": 200.0},
    "timestamp_skew": {"skew_s": -0.7},
    "self_heating": {"theta_K_per_W": 2000.0},
}


def model_with(*names: str) -> str:
    tables = (f'\n[[effects]]\nname = "{n}"\n' + "".join(f"{k} = {v}\n" for k, v in EFFECTS[n].items()) for n in names)
    return MODEL + "".join(tables)


@pytest.fixture
def folder(tmp_path: Path, peltier: Peltier) -> Path:
    """Models, and a record with all the effects."""
    path = write_bench(tmp_path, target=CURRENTS)
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(text.replace("period_s = 0.1", "period_s = 0.5"))
    (tmp_path / "all.toml").write_text(model_with(*EFFECTS))
    film_side = [n for n in EFFECTS if n not in ("sensor_lag", "heat_sink_warmup")]
    (tmp_path / "film.toml").write_text(model_with(*film_side))
    for name, switched in (("all", EFFECTS), ("film", film_side)):
        told = [n + ":" + ",".join(f"{k}={v}" for k, v in EFFECTS[n].items()) for n in switched]
        words = [word for text in told for word in ("--effect", text)]
        assert peltier("simulate", path, *words, "--out", tmp_path / f"{name}.csv")[0] == 0
    return tmp_path


def predicted(peltier: Peltier, model: Path, record: Path, *words: object) -> dict[str, float]:
    out = peltier.succeeds("predict", model, record, *words, "--json", "-")
    return dict(json.loads(out))


def test_from_the_current(folder: Path, peltier: Peltier) -> None:
    base = predicted(peltier, folder / "model.toml", folder / "all.csv")
    extended = predicted(peltier, folder / "all.toml", folder / "all.csv", "--out", folder / "p.csv")
    assert base["rmse_K"] > 0.5
    assert base["rmse_dec"] > 0.02
    assert extended["rmse_K"] == pytest.approx(0.005, rel=0.3)  # the noise
    assert extended["rmse_dec"] == pytest.approx(0.001, rel=0.3)
    assert read_record(folder / "p.csv").has("predicted_degC")


def test_from_the_temperature_alone(folder: Path, peltier: Peltier) -> None:
    record = read_record(folder / "film.csv")
    kept = {name: column for name, column in record.columns.items() if name != "current_A"}
    write_columns(folder / "film_only.csv", kept)
    base = predicted(peltier, folder / "model.toml", folder / "film_only.csv")
    extended = predicted(peltier, folder / "film.toml", folder / "film_only.csv")
    assert extended["film_driven_by"] == "temperature"
    assert extended["rmse_dec"] < 0.003 < 0.02 < base["rmse_dec"]


def test_self_heating_without_a_test_current_is_told(folder: Path, peltier: Peltier) -> None:
    record = read_record(folder / "film.csv")
    kept = {name: column for name, column in record.columns.items() if name != "meter_current_A"}
    write_columns(folder / "quiet.csv", kept)
    status, _, err = peltier("predict", folder / "film.toml", folder / "quiet.csv")
    assert status == 0
    assert "no meter_current_A" in err


def test_a_model_with_faulty_effects(tmp_path: Path, peltier: Peltier) -> None:
    (tmp_path / "bad.toml").write_text(MODEL + '\n[[effects]]\nname = "film_lag"\n[[effects]]\ntau_s = 1.0\n')
    (tmp_path / "r.csv").write_text("time_s,temperature_degC\n0,30\n1,31\n")
    err = peltier.fails("predict", tmp_path / "bad.toml", tmp_path / "r.csv")
    assert err.splitlines()[0].endswith("effects[0]: film_lag: tau_s: missing; expected a number")
    assert "effects[1]: name: missing" in err.splitlines()[1]


LAG_AND_LEADS = """
[[effects]]
name = "film_lag"
tau_s = 4.0
[[effects]]
name = "series_resistance"
series_ohm = 300.0
"""


def test_the_law_gains_from_them(tmp_path: Path, peltier: Peltier) -> None:
    """A film that lags, and leads in series: whoever has them in the model is followed at less than half the error."""
    path = write_bench(tmp_path, target='["start 15 kohm", "hold 3 s", "ramp to 6 kohm at 0.04 dec/s"]')
    text = path.read_text().replace('model = "model.toml"', 'model = "known.toml"', 1)
    text += LAG_AND_LEADS.replace("effects", "simulation.effects")
    path.write_text(text)
    rms = []
    for name, known in (("base", MODEL), ("extended", MODEL + LAG_AND_LEADS)):
        (tmp_path / "known.toml").write_text(known)
        peltier.succeeds("run", path, "--out", tmp_path / name, "--json", tmp_path / f"{name}.json")
        rms.append(json.loads((tmp_path / f"{name}.json").read_text())["scores"]["full"]["rms_dec"])
    assert rms[1] < 0.45 * rms[0]
    assert rms[1] < 0.04


@pytest.mark.parametrize(("to_degC", "less"), [(86.0, 0.3), (None, 1.02)])
def test_the_first_rows_after_a_gap_tell_what_the_film_went_through(to_degC: float | None, less: float) -> None:
    time, v, y = with_an_excursion(to_degC)
    record = record_from_arrays({"time_s": time, "temperature_degC": v, "resistance_ohm": 10.0**-y})
    model = Model(is_prandtl_ishlinskii(1), None)
    straight = rig.predict(model, record, initial="cooled")
    assert any("1 gap in which the temperature is unknown, the longest of 200 s" in note for note in straight.notes)
    fitted = rig.predict(model, record, initial="fitted")
    assert fitted.rmse_dec is not None
    assert straight.rmse_dec is not None
    assert fitted.rmse_dec < less * straight.rmse_dec
    went = "no excursion" if to_degC is None else "as if the temperature had gone to"
    assert any(went in note for note in fitted.notes)
    if to_degC is None:
        assert fitted.rmse_dec == pytest.approx(NOISE, rel=0.1)


def test_a_record_without_gaps_has_no_note() -> None:
    time, v, y = (column[:800] for column in with_an_excursion(None))
    record = record_from_arrays({"time_s": time, "temperature_degC": v, "resistance_ohm": 10.0**-y})
    assert rig.predict(Model(is_prandtl_ishlinskii(1), None), record).notes == ()
