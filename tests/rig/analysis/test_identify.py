"""`identify` and `predict` with their reports; films that rise, other outputs; the measured films."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.thermal.plate import PlateModel
from rig.config.model_file import Model, read_model, write_model
from rig.records.record_file import read_record, write_columns
from tests.peltier import Peltier
from tests.rig.small import write_bench

FILM = FilmModel(
    np.array([0.05, 0.15, 0.25, 0.4, 0.55]),
    np.array([0.2, 0.3, 0.3, 0.25, 0.2]),
    Envelope("tanh", 0.2, -12.2),
    Envelope("tanh", 0.2, -11.9),
    Memoryless("tanh", 0.3, 0.03, -1.6, 3.3),
    output="log10_ohm",
)


def columns(output: Callable[[np.ndarray], np.ndarray], name: str) -> dict[str, np.ndarray]:
    """A record of the film, with what a meter reads of its log10 R."""
    points = [25.0, 90.0, 25.0, 75.0, 50.0, 66.0, 55.0, 62.0, 25.0]
    travel = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(points)))))
    x = np.arange(0.0, travel[-1], 0.4)
    degC = np.interp(x, travel, points)
    u, _ = FILM.simulate(degC, FILM.initial_memory(25.0, "heated"))
    noise = np.random.default_rng(0).standard_normal((2, x.size))
    return {"time_s": x / 0.3, "temperature_degC": degC + 0.01 * noise[0], name: output(u + 0.002 * noise[1])}


@pytest.mark.parametrize(
    ("name", "output", "kept", "target", "value"),
    [
        ("resistance_ohm", lambda u: 10.0**u, "log10_ohm", "target_ohm", 2000.0),
        ("resistance_ohm", lambda u: 10.0 ** (8.0 - u), "minus_log10_ohm", "target_ohm", 5e4),
        ("transmission_percent", lambda u: 40.0 - 10.0 * u, "minus_transmission_percent", None, 7.0),
        ("voltage_V", lambda u: u - 4.0, "voltage_V", None, -0.7),
    ],
)
def test_either_sense_and_other_outputs(
    peltier: Peltier,
    tmp_path: Path,
    name: str,
    output: Callable[[np.ndarray], np.ndarray],
    kept: str,
    target: str | None,
    value: float,
) -> None:
    """Identified, told, predicted and inverted from the command line."""
    record, model = tmp_path / "r.csv", tmp_path / "m.toml"
    write_columns(record, columns(output, name))
    words = [] if name == "resistance_ohm" else ["--output", name]
    quick = ["--kind", "extended_generalized_pi", "--form", "tanh", "--operators", 8]
    out = peltier.succeeds("identify", record, *words, *quick, "--out", model, "--json", tmp_path / "i.json")
    assert "transition temperature on heating" in out
    film = read_model(model, needs=("film",)).film
    assert film is not None
    assert film.output == kept
    told = json.loads((tmp_path / "i.json").read_text())["transition"][0]
    assert told["heating_degC"]["value"] == pytest.approx(61.9, abs=0.5)
    assert told["hysteresis_K"]["ci95"][0] < told["hysteresis_K"]["value"] < told["hysteresis_K"]["ci95"][1]
    peltier.succeeds("predict", model, record, "--out", tmp_path / "p.csv", "--json", tmp_path / "p.json")
    unit = {"transmission_percent": "percent", "voltage_V": "V"}.get(name, "dec")
    scale = 10.0 if unit == "percent" else 1.0
    assert json.loads((tmp_path / "p.json").read_text())[f"rmse_{unit}"] < 0.006 * scale
    shown = read_record(tmp_path / "p.csv")
    predicted = shown["predicted_ohm" if unit == "dec" else f"predicted_{name}"]
    assert np.corrcoef(predicted, shown[name])[0, 1] > 0.999
    wanted = target or f"target_{name}"
    write_columns(tmp_path / "t.csv", {"time_s": np.array([0.0, 9.0]), wanted: np.array([value, value])})
    peltier.succeeds("invert", model, tmp_path / "t.csv", "--limits", "20,95", "--out", tmp_path / "v.csv")
    inverted = read_record(tmp_path / "v.csv", needs=("temperature_degC",))
    assert inverted["reachable"].tolist() == [1.0, 1.0]
    assert inverted[name] == pytest.approx(value, rel=1e-6)


def test_reports_of_identify_and_predict(peltier: Peltier, tmp_path: Path) -> None:
    write_columns(tmp_path / "r.csv", columns(lambda u: 10.0 ** (8.0 - u), "resistance_ohm"))
    quick = ["--kind", "extended_generalized_pi", "--form", "tanh", "--operators", 8]
    out = peltier.succeeds("identify", tmp_path / "r.csv", *quick, "--report", tmp_path / "i")
    assert str(tmp_path / "i" / "report.html") in out
    assert "FORC" not in out  # a loop for which nobody meant a diagram
    peltier.succeeds("predict", tmp_path / "i" / "model.toml", tmp_path / "r.csv", "--report", tmp_path / "p")
    for folder, figures in (("i", ("loop", "residual", "derivative")), ("p", ("over_time", "residual"))):
        page = (tmp_path / folder / "report.html").read_text()
        assert not {"http://", "https://"} & {word[:8] for word in page.split('src="')[1:]}
        for name in figures:
            assert (tmp_path / folder / "figures" / f"{name}.svg").is_file()
            assert f'id="{name}-' in page
    page = (tmp_path / "i" / "report.html").read_text()
    assert "transition temperature on heating" in page
    assert "(FORC): not drawn" in page
    assert json.loads((tmp_path / "i" / "identification.json").read_text())["transition"][0]["record"].endswith("r.csv")
    assert json.loads((tmp_path / "p" / "prediction.json").read_text())["rmse_dec"] < 0.006


@pytest.mark.long
def test_a_film_that_rises_is_calibrated_and_tracked(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, more="\n[calibration]\ntemperature_degC = [30, 90]\nminor_loops = 6\n")
    text = path.read_text().replace("first_degC = 60.0", "first_degC = 25.0")
    words = '["start 3 kohm", "hold 5 s", "ramp to 8 kohm in 20 s", "hold 10 s"]'
    path.write_text("\n".join(f"target = {words}" if line.startswith("target") else line for line in text.splitlines()))
    write_model(tmp_path / "model.toml", Model(FILM, PlateModel(1.6e-3, 0.06, 0.018, 25.0)))
    out = peltier.succeeds("calibrate", path, "--out", tmp_path / "cal", "--json", tmp_path / "c.json")
    assert "transition temperature on cooling" in out
    result = json.loads((tmp_path / "c.json").read_text())
    assert result["check_rmse_dec"] < 0.004
    assert result["transition"][0]["heating_degC"]["value"] == pytest.approx(62.0, abs=0.6)
    assert "The transition" in (tmp_path / "cal" / "report.html").read_text()
    peltier.succeeds("run", path, "--out", tmp_path / "run", "--json", tmp_path / "r.json")
    assert json.loads((tmp_path / "r.json").read_text())["scores"]["full"]["rms_dec"] < 0.02


@pytest.mark.parametrize(
    ("file", "cooling", "energy"),
    [("vo2_film_major_loop.tsv", (67.0, 70.0), 0.26), ("vo2_film_small_gap_raw.tsv", (62.0, 65.0), 0.26)],
)
def test_measured_films_as_published(measured: Path, file: str, cooling: tuple[float, float], energy: float) -> None:
    """VO2 switches between 60 and 77 degC with a few kelvin of hysteresis, and its insulator has 0.1 to 0.5 eV."""
    from rig.analysis.transition import numbers_of_record

    numbers = numbers_of_record(read_record(measured / file), "minus_log10_ohm").document()
    values = {name: entry["value"] for name, entry in numbers.items() if isinstance(entry, dict) and "value" in entry}
    assert None not in values.values()
    assert cooling[0] < values["cooling_degC"] < cooling[1]
    assert values["cooling_degC"] < values["heating_degC"] < 77.0
    assert 4.0 < values["hysteresis_K"] < 8.0
    assert 4.2 < values["change_dec"] < 4.5
    low, high = numbers["activation_energy_eV"]["ci95"]
    assert low < energy < high


def test_every_measured_record_ends_in_numbers_or_in_a_line(peltier: Peltier, measured: Path) -> None:
    """None of them has a film that takes long; those of plates alone say so."""
    files = [*sorted(measured.glob("peltier_*.csv")), *sorted(measured.glob("heater_*")), measured / "lamp_heating.csv"]
    assert len(files) >= 10
    for file in files:
        status, out, err = peltier("identify", file)
        assert status in (0, 2), file
        assert "Traceback" not in out + err
        assert "plate: RMS error" in out if status == 0 else "expected" in err


def test_a_page_warns_of_what_the_terminal_does(tmp_path: Path, peltier: Peltier) -> None:
    """Else "no warning" stands below a transition of which nothing is determined."""
    late = columns(lambda u: 10.0**u, "resistance_ohm")
    late["resistance_ohm"] = np.roll(late["resistance_ohm"], 8)  # 3 K of film lag on each ramp, less at its turns
    write_columns(tmp_path / "late.csv", {name: values[8:] for name, values in late.items()})
    status, out, _ = peltier(
        "identify", tmp_path / "late.csv", "--kind", "generalized_pi", "--report", tmp_path / "page"
    )
    page = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert status == 0
    assert out.count("not determined, because the film model misses this record") == 1
    assert "bad: more than 0.02 dec" in out
    for text in ("The film model is bad", "none of the transition&#x27;s numbers can be given"):
        assert text in page
    assert "No warning" not in page


def test_a_record_of_a_temperature_alone_says_what_its_other_column_is_good_for(
    tmp_path: Path, peltier: Peltier
) -> None:
    """Else whoever follows the first hint is refused a second time, and learns nothing of the lamp's voltage."""
    degC = 40.0 + 20.0 * np.sin(np.arange(100.0) / 10.0)
    write_columns(tmp_path / "lamp.csv", {"time_s": np.arange(100.0), "temperature_degC": degC, "u_V": degC / 10.0})
    status, _, err = peltier("diagnose", tmp_path / "lamp.csv")
    assert status == 2
    for text in ("Not used: u_V", "--column current_A=u_V@A", "share of full power"):
        assert text in err
