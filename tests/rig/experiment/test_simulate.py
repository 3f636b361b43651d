"""peltier simulate: every kind of experiment, effects by word, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig.records.record_file import read_record
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench

CURRENTS = '["start 1 A", "hold 5 s", "ramp to 2 A in 10 s", "hold 5 s"]'


def of_kind(folder: Path, kind: str, target: str, **more: str) -> Path:
    path = write_bench(folder, target=target, **more, kind=kind)
    return path


def test_a_current_profile_is_exact_at_its_rows(tmp_path: Path, peltier: Peltier) -> None:
    path = of_kind(tmp_path, "current_profile", CURRENTS)
    out = peltier.succeeds("simulate", path, "--seed", 3, "--json", "-", "--out", tmp_path / "r.csv")
    assert json.loads(out)["effects"] == []
    record = read_record(tmp_path / "r.csv")
    assert record.rows == 200
    np.testing.assert_allclose(record["time_s"], 0.1 * np.arange(200), atol=1e-12)
    assert set(record.columns) == {"time_s", "temperature_degC", "current_A", "resistance_ohm", "meter_current_A"}
    peltier("simulate", path, "--seed", 3, "--out", tmp_path / "same.csv")
    assert (tmp_path / "same.csv").read_bytes() == (tmp_path / "r.csv").read_bytes()
    peltier("simulate", path, "--seed", 4, "--out", tmp_path / "other.csv")
    assert (tmp_path / "other.csv").read_bytes() != (tmp_path / "r.csv").read_bytes()


def test_a_plate_with_slopes_is_simulated_and_predicted(tmp_path: Path, peltier: Peltier) -> None:
    """S and R_e that grow with temperature, from a configuration into a record and from a model file into a prediction,
    against a library's integrator: who compares a rig with its twin must not see the twin's own error."""
    slopes = {"seebeck": 0.002, "resistance": 0.004}
    own = MODEL[MODEL.index("[plate]") :] + "".join(f"{name}_slope_per_K = {v}\n" for name, v in slopes.items())
    path = of_kind(tmp_path, "current_profile", CURRENTS, more=own.replace("[plate]", "[simulation.plate]"))
    (tmp_path / "model.toml").write_text(MODEL.replace(MODEL[MODEL.index("[plate]") :], own))
    path.write_text(path.read_text().replace("[simulation]\n", "[simulation]\nthermometer_noise_K = 0.0\n"))
    assert peltier("simulate", path, "--out", tmp_path / "r.csv")[0] == 0
    record = read_record(tmp_path / "r.csv")

    def rate(_: float, t: float, current: float) -> float:
        s, r = (1.0 + slope * (t - 25.0) for slope in slopes.values())
        return 1.6e-3 * s * current * (t + 273.15) + 0.03 * r * current**2 - 0.018 * (t - 25.0)

    time, degC = record["time_s"], [float(record["temperature_degC"][0])]
    for k, dt in enumerate(np.diff(time)):
        args = (record["current_A"][k],)
        degC.append(solve_ivp(rate, (0.0, dt), degC[-1:], args=args, rtol=1e-11, atol=1e-11).y[0, -1])
    assert degC[-1] > 65.0
    np.testing.assert_allclose(record["temperature_degC"], degC, atol=1e-8)
    words = ("--drive", "current", "--out", tmp_path / "p.csv")
    assert peltier("predict", tmp_path / "model.toml", tmp_path / "r.csv", *words)[0] == 0
    np.testing.assert_allclose(read_record(tmp_path / "p.csv")["predicted_degC"], degC, atol=1e-8)


def test_test_currents_of_the_target_file(tmp_path: Path, peltier: Peltier) -> None:
    rows = "time_s,current_A,meter_current_A\n0,1,1e-5\n10,1,1e-3\n20,1,1e-3\n"
    (tmp_path / "target.csv").write_text(rows)
    path = of_kind(tmp_path, "current_profile", '"target.csv"')
    words = ("--effect", "self_heating:theta_K_per_W=5000", "--out", tmp_path / "r.csv")
    assert peltier("simulate", path, *words)[0] == 0
    record = read_record(tmp_path / "r.csv")
    resistance, test = record["resistance_ohm"], record["meter_current_A"]
    assert set(test) == {1e-5, 1e-3}
    k = int(np.argmax(test == 1e-3))
    assert resistance[k] < 0.9 * resistance[k - 1]  # warm at once


@pytest.mark.parametrize("kind", ["track_resistance", "temperature_profile", "hold"])
def test_closed_loop_whatever_the_ports(tmp_path: Path, peltier: Peltier, kind: str) -> None:
    target = '["start 60 degC", "hold 4 s"]' if kind != "track_resistance" else '["start 9 kohm", "hold 4 s"]'
    path = of_kind(tmp_path, kind, target, time="real", controller="/dev/ttyUSB0", meter="/dev/ttyUSB1")
    words = ("--effect", "film_lag:tau_s=1", "--effect", "sensor_lag:tau_s=0.5", "--effect", "timestamp_skew:skew_s=-1")
    out = peltier.succeeds("simulate", path, *words, "--out", tmp_path / "r.csv")
    assert "film_lag: tau_s = 1" in out
    record = read_record(tmp_path / "r.csv")
    for name in ("temperature_degC", "resistance_ohm", "current_A", "meter_current_A", "setpoint_degC"):
        assert record.has(name) or name == "setpoint_degC"
    early = (record["resistance_time_s"] - record["time_s"])[np.isfinite(record["resistance_time_s"])]
    assert np.all(np.abs(early + 1.0) < 0.2)


def test_effects_of_configuration_film_and_command_line(tmp_path: Path, peltier: Peltier) -> None:
    path = of_kind(tmp_path, "current_profile", CURRENTS)
    path.write_text(path.read_text() + '\n[[simulation.effects]]\nname = "creep"\nshare = 0.1\n')
    with (tmp_path / "model.toml").open("a") as model:
        model.write('\n[[effects]]\nname = "meter_lag"\ntau_s = 0.5\n')
    out = peltier.succeeds("simulate", path, "--effect", "series_resistance", "--out", tmp_path / "r.csv")
    told = out.splitlines()
    effects = [
        "creep: share = 0.1, tau_s = 316.228",
        "series_resistance: series_ohm = 15.8114",
        "meter_lag: tau_s = 0.5",
    ]
    assert told[1:4] == effects
    err = peltier.fails("simulate", path, "--effect", "meter_lag", "--out", tmp_path / "r.csv")
    assert "meter_lag: switched on twice" in err


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        ("film_lg", "did you mean 'film_lag'?"),
        ("film_lag:tau=3", "no parameter 'tau'; did you mean 'tau_s'?"),
        ("film_lag:tau_s=x", "expected NAME:param=value,... with numbers"),
        ("film_lag:tau_s=-1", "film_lag: tau_s: -1.0: expected a finite number > 0; usual: 0.2 to 10"),
        ("memoryless_term:a=1", "belongs to the film"),
    ],
)
def test_what_is_refused(tmp_path: Path, peltier: Peltier, effect: str, told: str) -> None:
    path = of_kind(tmp_path, "current_profile", CURRENTS)
    status, _, err = peltier("simulate", path, "--effect", effect, "--out", tmp_path / "r.csv")
    assert (status, err.count("\n")) == (2, 1)
    assert told in err
    assert not (tmp_path / "r.csv").exists()


def test_a_trip_keeps_the_rows(tmp_path: Path, peltier: Peltier) -> None:
    """The interlock watches a simulated rig too: the record ends there, with the trip's exit status."""
    path = write_bench(tmp_path, limits="[10, 74]", more="[calibration]\ntemperature_degC = [40, 73]\n")
    words = ("--effect", "sensor_lag:tau_s=8", "--effect", "actuator_delay:delay_s=4", "--out", tmp_path / "r.csv")
    assert "output off, confirmed" in peltier.fails("simulate", path, *words, status=10)
    assert read_record(tmp_path / "r.csv").rows > 10
