"""Bad input gets one clear line per fault - what, where, what is expected - and exit status 2; nothing is armed."""

from __future__ import annotations

import math
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import rig
from compensator.thermal.plate import PlateModel
from rig.config import configuration, model_file
from rig.config import tables as configuration_tables
from rig.config.model_file import Model
from rig.config.schema import Table
from rig.config.tables import ExperimentTable
from rig.core.faults import Faults
from rig.drivers import registry
from rig.records.conversion import record_from_arrays
from sim.inference.film.fit import identify_film
from sim.inference.readings.temperature_path import temperature_path
from sim.world.plant import World
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench
from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii


def test_a_law_that_is_named_twice_runs_once() -> None:
    """Its folder would be there already, after hours."""
    assert ExperimentTable(law="pid", compare=["feedforward", "pid", "feedforward"]).laws == ("pid", "feedforward")


def test_misspelt_keys_are_all_named_at_once(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, changed=[("current_A = 4.0", "curent_A = 4.0"), ("period_s", "perod_s")])
    status, out, err = peltier("run", path, "--out", tmp_path / "run")
    lines = err.strip().splitlines()
    assert status == 2
    assert out == ""
    assert any("limits.curent_A" in line and "current_A" in line for line in lines)
    assert any("limits.current_A: missing" in line for line in lines)
    assert any("experiment.perod_s" in line and "did you mean 'period_s'" in line for line in lines)
    assert all(str(path) in line for line in lines)
    assert not (tmp_path / "run").exists()


CALIBRATION = "\n[calibration]\n{}\n[limits]"
TEMPERATURES = 'kind = "temperature_profile"\ntarget = ["start 30 degC", "ramp to 99 degC at 2 K/s"]\n#'
CURRENTS = 'kind = "current_profile"\ntarget = ["start 0 A", "hold 2 s", "step to 9 A"]\n#'
KIND = 'kind = "track_resistance"'


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (KIND, 'kind = "track"', "experiment.kind"),
        ("period_s = 0.1", "period_s = -0.1", "experiment.period_s"),
        ("period_s = 0.1", "period_s = inf", "experiment.period_s"),
        ("temperature_degC = [10, 95]", "temperature_degC = [95, 10]", "limits.temperature_degC"),
        ('driver = "meerstetter"', 'driver = "meerstater"', "bench.controller.driver"),
        ('model = "model.toml"\ntarget', 'model = "no_such.toml"\ntarget', "experiment.model"),
        ('"start 20 kohm", ', "", "experiment.target"),
        ('"ramp to 5 kohm at 0.1 dec/s"', '"ramp to 5 kfoo at 0.1 dec/s"', "experiment.target[2]"),
        ('"ramp to 5 kohm at 0.1 dec/s"', '"ramp to 5 kohm at 0.1 dec/s", "dwell"', "experiment.target[3]"),
        ('"ramp to 5 kohm at 0.1 dec/s"', '"ramp to 20 Mohm at 0.1 dec/s"', "ohm is outside the film's range"),
        (KIND, TEMPERATURES, "at 34.5 s: 99 degC is outside limits.temperature_degC; expected 10 to 95 degC"),
        (KIND, CURRENTS, "at 2 s: 9 A is outside limits.current_A; expected -4 to 4 A"),
        (
            KIND,
            KIND + '\ntarget = "long.csv"\n#',
            "long.csv: time_s: from 0 to 1e+09: expected a profile of three years",
        ),
        ("[limits]", "[limits", "is not valid TOML"),
        (
            "[limits]",
            CALIBRATION.format("temperature_degC = [5, 90]"),
            "calibration.temperature_degC: [5.0, 90.0]: expected within limits",
        ),
        (
            "[limits]",
            CALIBRATION.format("temperature_degC = [30, 70]\ntransition_degC = [50, 75]"),
            "transition_degC: [50.0, 75.0]: expected within calibration.temperature_degC [30.0, 70.0]",
        ),
        (  # told before a port is opened: it would be held by this very program
            'port = "sim://"',
            'port = "/dev/ttyNONE"',
            "bench.meter.port: '/dev/ttyNONE' is bench.controller.port too",
        ),
    ],
)
def test_one_wrong_value(peltier: Peltier, tmp_path: Path, old: str, new: str, told: str) -> None:
    """It is told before anything is on, and before there is a folder of the run."""
    path = write_bench(tmp_path)
    (tmp_path / "long.csv").write_text("time_s,target_ohm\n0,20000\n1e9,15000\n")
    text = path.read_text()
    assert old in text
    if new.endswith("#"):  # another target in place of the one there
        text = text.replace("target = ", "# ")
    text = text.replace(old, new)
    path.write_text(text.replace('time = "virtual"', "") if "ttyNONE" in new else text)
    err = peltier.fails("run", path, "--out", tmp_path / "run")
    assert told in err
    assert str(tmp_path) in err
    assert not [*tmp_path.glob("run*")]


def test_no_verb_and_wrong_verb(peltier: Peltier) -> None:
    assert "did you mean 'calibrate'" in peltier.fails("calibrat")
    assert peltier()[0] == 2
    assert peltier("--help")[0] == 0


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("a = 0.2\nb = -12.6", "a = -0.2\nb = -12.6", "film.rising.a"),
        ("weights = [0.4, 0.3, 0.2, 0.1]", "weights = [0.4, 0.3, 0.2]", "film"),
        ("weights = [0.4, 0.3, 0.2, 0.1]", "weights = [0.4, 0.3, 0.2, -0.1]", "film.weights.3"),
        ("[film.falling]", "[film.faling]", "film.faling"),
        ("ambient_degC = 25.0", "", "plate.ambient_degC: missing"),
        ("ambient_degC = 25.0", "ambient_degC = 25.0\nseebeck_slope_per_K = 0.2", "plate.seebeck_slope_per_K"),
    ],
)
def test_wrong_models(peltier: Peltier, tmp_path: Path, old: str, new: str, place: str) -> None:
    model, target = tmp_path / "model.toml", tmp_path / "target.csv"
    assert old in MODEL
    model.write_text(MODEL.replace(old, new))
    target.write_text("time_s,target_ohm\n0,10000\n")
    err = peltier.fails("invert", model, target, "--out", tmp_path / "out.csv")
    assert str(model) in err
    assert place in err


def _record(path: Path, temperature: object, resistance: object) -> Path:
    import numpy as np

    time = np.arange(200.0)
    rows = zip(time, np.broadcast_to(temperature, 200), np.broadcast_to(resistance, 200), strict=True)
    path.write_text("time_s,temperature_degC,resistance_ohm\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    return path


@pytest.mark.parametrize(
    ("temperature", "resistance", "expected"),
    [
        (60.0, 1e4, "temperature_degC: constant at 60"),
        ("nan", 1e4, "temperature_degC: no finite number"),
        (60.0, "nan", "resistance_ohm: no finite number"),
        (60.0, "inf", "resistance_ohm: no finite number"),
    ],
)
def test_records_that_say_nothing(
    peltier: Peltier, tmp_path: Path, temperature: object, resistance: object, expected: str
) -> None:
    path = _record(tmp_path / "record.csv", temperature, resistance)
    err = peltier.fails("identify", path)
    assert len(err.strip().splitlines()) == 1
    assert str(path) in err
    assert expected in err


def test_a_record_that_never_crosses_the_transition_is_told_so(peltier: Peltier, tmp_path: Path) -> None:
    import numpy as np

    wave = np.sin(np.arange(200.0) / 20.0)
    path = _record(tmp_path / "record.csv", 20.0 + 10.0 * wave, 10.0 ** (5.0 - 0.1 * wave))
    out = peltier.succeeds("identify", path)
    assert "does not cross the transition" in out


@pytest.mark.parametrize("driver", sorted(registry.CONTROLLERS))
def test_every_option_of_a_controller_takes_its_own_kind_only(peltier: Peltier, tmp_path: Path, driver: str) -> None:
    names = set(signature(registry.controller_class(driver)).parameters) - {"transport", "line"}
    for name in {*names, "framing", "model"}:
        for value in ("-1.5", "1e300", "nan", '""', '"no such"'):
            path = tmp_path / "bench.toml"
            path.write_text(
                f'[bench.controller]\ndriver = "{driver}"\nport = "sim://"\noptions = {{{name} = {value}}}\n'
                '[limits]\ncurrent_A = 0.5\n[experiment]\nkind = "hold"\n'
            )
            if (name, value) == ("p_A_per_K", "-1.5"):
                continue  # a negative gain is one that regulates
            status, _, err = peltier("check", path)
            assert (status, len(err.splitlines())) == (2, 1), f"{name} = {value}: {err}"
            assert f"{path}: bench.controller.options" in err
            assert "expected" in err or "there are" in err or "should be" in err


def test_a_value_that_may_be_of_several_kinds_has_one_line(peltier: Peltier, tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(
        '[bench.controller]\ndriver = "tclab"\nport = "sim://"\n'
        '[bench.meter]\ndriver = "keithley2000"\nport = "sim://"\noptions = {a = [1], b = nan}\n'
        '[limits]\ncurrent_A = 0.5\n[experiment]\ntarget = ["start 20 kohm", 5]\n'
        '[sweep]\nseeds = "x"\n[simulation.film]\nrelais = 5\nmemoryless = {a = "x"}\n'
    )
    err = peltier.fails("run", path, "--out", tmp_path / "run")
    places = [line.removeprefix(f"{path}: ").partition(": ")[0] for line in err.splitlines()]
    assert {"bench.meter.options.a", "bench.meter.options.b", "experiment.target.1", "sweep.seeds"} <= set(places)
    assert {"simulation.film.relais", "simulation.film.memoryless.a"} <= set(places)
    assert len(places) == len(set(places))


def test_a_misspelt_key_of_an_operator_is_told_with_what_was_meant(peltier: Peltier, tmp_path: Path) -> None:
    envelope = '{function = "tanh", a = 0.2, b = -12.0}'
    operator = f"[[film.operators]]\nradius = 0.0\nwieght = 1.0\nrising = {envelope}\nfalling = {envelope}\n"
    (tmp_path / "model.toml").write_text(f'[film]\nkind = "mixed_envelopes"\n{operator}')
    (tmp_path / "target.csv").write_text("time_s,target_ohm\n0,20000\n")
    err = peltier.fails("invert", tmp_path / "model.toml", tmp_path / "target.csv")
    assert "film.operators.0.wieght: unknown key; did you mean 'weight'?" in err


def test_of_joint_records_the_one_without_a_current_is_named(peltier: Peltier, tmp_path: Path) -> None:
    rows = "".join(f"{k},{25.0 + 0.1 * k},{5e4 * 10.0 ** (-0.03 * k)},0.5\n" for k in range(60))
    (tmp_path / "with.csv").write_text("time_s,temperature_degC,resistance_ohm,current_A\n" + rows)
    without = "".join(f"{line.rsplit(',', 1)[0]}\n" for line in rows.splitlines())
    (tmp_path / "without.csv").write_text("time_s,temperature_degC,resistance_ohm\n" + without)
    err = peltier.fails("diagnose", tmp_path / "with.csv", tmp_path / "without.csv", "--joint")
    assert "without.csv: current_A: missing; expected it in all records of a rig or in none" in err


@pytest.mark.parametrize("words", [("init",), ("identify", "r", "--report"), ("diagnose", "r", "--report")])
def test_a_file_in_a_folder_s_place_is_told_first(peltier: Peltier, tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "taken").write_text("")
    status, out, err = peltier(*words, tmp_path / "taken")
    assert (status, out) == (2, "")
    assert err == f"{tmp_path / 'taken'}: is a file; expected a folder\n"


# ---- numbers that are none, or that the quantity cannot have ----------------------------------------


NONE = (math.nan, -0.01, math.inf, -math.inf)


def film_record(rows: int = 400) -> tuple[np.ndarray, ...]:
    v = decaying_profile(rows)
    film = is_prandtl_ishlinskii(0)
    return np.arange(float(rows)), v, film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0]


@pytest.mark.parametrize("noise_K", NONE)
def test_a_thermometers_noise_is_a_number_of_kelvins(noise_K: float) -> None:
    time, v, y = film_record()
    with pytest.raises(ValueError, match=r"temperature_noise_K: .*: expected K, 0 .* or more, or None"):
        identify_film(time, v, y, temperature_noise_K=noise_K)
    with pytest.raises(ValueError, match="temperature_noise_K"):
        temperature_path(time, v, noise_K=noise_K)


@pytest.mark.parametrize("first_s", [*NONE, 0.0])
def test_seconds_of_first_rows(first_s: float) -> None:
    time, v, y = film_record()
    record = record_from_arrays({"time_s": time, "temperature_degC": v, "resistance_ohm": 10.0**-y})
    with pytest.raises(Faults, match=r"first_s=.*: expected a number of seconds > 0"):
        rig.predict(Model(is_prandtl_ishlinskii(0), None), record, initial="fitted", first_s=first_s)


@pytest.mark.parametrize("key", ["thermometer_noise_K", "ohmmeter_noise_dec"])
def test_a_simulated_reading_has_a_noise(key: str) -> None:
    for noise in NONE:
        with pytest.raises(ValueError, match=f"{key}: .*: expected a finite number >= 0"):
            World(PlateModel(1.6e-3, 0.06, 0.018, 25.0), is_prandtl_ishlinskii(0), **{key: noise})


@pytest.mark.parametrize("seconds", ["nan", "-1", "0"])
def test_seconds_to_watch_for(peltier: Peltier, seconds: str) -> None:
    assert f"--seconds: {seconds}: expected a number of seconds > 0" in peltier.fails("watch", f"--seconds={seconds}")


def test_no_key_of_any_file_takes_what_is_no_number() -> None:
    modules = (configuration, model_file, configuration_tables)
    tables = {t for m in modules for t in vars(m).values() if isinstance(t, type) and issubclass(t, Table)}
    looked_at = 0
    for table in tables - {Table}:
        for key, field in table.model_fields.items():
            if "float" not in str(field.annotation):
                continue
            for bad in (math.nan, math.inf, -math.inf):
                for value in (bad, [bad], [bad, 1.0], [1.0, bad], {"x": bad}, {"x": [bad, 1.0]}, {"x": [1.0, bad]}):
                    with pytest.raises(ValidationError) as found:
                        table.model_validate({key: value})
                    assert any(error["loc"][0] == key for error in found.value.errors()), (table, key, value)
            looked_at += 1
    assert looked_at > 50
