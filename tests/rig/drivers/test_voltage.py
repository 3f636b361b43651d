"""A voltage that stands for another quantity: formula, meters and their emulators, configuration, a bench with it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.bench.assembly import open_bench
from rig.config.configuration import read_configuration
from rig.core.clock import VirtualClock
from rig.core.errors import Overrange
from rig.core.faults import Faults
from rig.core.reading import Quality, Reading
from rig.drivers.meter import column_of, film_output, formula
from rig.drivers.registry import METERS, open_meter
from rig.records.record_file import read_record
from sim.instruments.instrument import Instrument, emulated
from tests.peltier import Peltier
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.mark.parametrize(
    ("text", "voltage_V", "expected"),
    [
        ("voltage_V", 1.5, 1.5),
        ("(voltage_V - 0.131) * 22.4", 0.631, 11.2),
        ("-2 + 3 * voltage_V ** 2 / 4", 2.0, 1.0),
        ("-voltage_V ** 2", 3.0, -9.0),
        ("2 ** 3 ** voltage_V", 2.0, 512.0),
        ("log10(voltage_V) + exp(0) - sqrt(4)", 100.0, 1.0),
        (" 1e-3 * voltage_V\n", 5.0, 5e-3),
    ],
)
def test_formula(text: str, voltage_V: float, expected: float) -> None:
    assert formula(text)(voltage_V) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    "text",
    ["1 / voltage_V", "log10(voltage_V)", "(voltage_V - 1) ** 0.5", "exp(1e9 + voltage_V)", "10 ** (400 + voltage_V)"],
)
def test_what_has_no_value_is_nan(text: str) -> None:
    assert math.isnan(formula(text)(0.0))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "3.0",
        "voltage",
        "voltage_V.real",
        "__import__('os').system('true') + voltage_V",
        "exp(voltage_V, 2)",
        "exp(x=voltage_V)",
        "abs(voltage_V)",
        "[voltage_V][0]",
        "voltage_V if 1 else 2",
        "lambda: voltage_V",
        "voltage_V; 1",
        "voltage_V // 2",
        "voltage_V < 2",
        "'1' + voltage_V",
        "True + voltage_V",
        "1j * voltage_V",
        "(" * 150 + "voltage_V",
        "voltage_V + " + "1" * 300,
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="formula"):
        formula(text)


@given(st.text(alphabet="voltage_V0123456789.+-*/() explg,=[]'", max_size=60))
@settings(max_examples=100, deadline=None)
def test_no_text_does_harm(text: str) -> None:
    try:
        found = formula(text)
    except ValueError:
        return
    assert isinstance(found(1.0), float)


@pytest.mark.parametrize("name", METERS)
def test_meters_read_volts(attach: Attach, clock: VirtualClock, plant: StillPlant, name: str) -> None:
    plant.voltage_V = 1.25
    meter = open_meter(
        name, attach(emulated(name, plant)), clock, formula="(voltage_V - 1) * 4", output="curvature_per_m"
    )
    meter.identify()
    meter.configure(True, 1.0, 1e-3)
    assert meter.output == "curvature_per_m"
    assert (meter.test_current_A, plant.test_current_A) == (0.0, 0.0)
    assert meter.full_scale >= 10.0
    for voltage_V in (1.25, -3.5, 0.0):
        plant.voltage_V = voltage_V
        reading = meter.read()
        assert (reading.value, reading.quality) == (pytest.approx(4 * voltage_V - 4, rel=1e-5), Quality.OK)
        assert reading.time_s == pytest.approx(plant.sampled_s, abs=2e-3)
    plant.voltage_V = -99.0
    over = meter.read()
    assert over.quality is Quality.OVERRANGE
    with pytest.raises(Overrange):
        over.number()
    plant.voltage_V = 2.0
    assert meter.off()
    assert meter.read().value == 4.0
    meter.close()


@pytest.mark.parametrize("name", METERS)
def test_a_voltage_itself(attach: Attach, clock: VirtualClock, plant: StillPlant, name: str) -> None:
    meter = open_meter(name, attach(emulated(name, plant)), clock)
    plant.voltage_V = 0.05
    meter.configure_voltage(1.0, 0.1)  # type: ignore[attr-defined]
    assert meter.output == "voltage_V"
    assert meter.read().value == pytest.approx(0.05, rel=1e-6)
    plant.resistance_ohm = 5e4
    meter.configure(True, 1.0, 1e-3)
    assert (meter.read().value, meter.output) == (5e4, "minus_log10_ohm")
    for range_V in (0.0, -1.0, 1e4, math.nan):
        with pytest.raises(ValueError, match="range"):
            meter.configure_voltage(1.0, range_V)  # type: ignore[attr-defined]


def test_no_value_is_invalid(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    address = attach(emulated("keithley2000", plant))
    meter = open_meter("keithley2000", address, clock, formula="log10(voltage_V)", output="depth_um")
    meter.configure(True, 1.0, 1e-3)
    plant.voltage_V = -1.0
    assert meter.read().quality is Quality.INVALID


def test_film_output_and_column() -> None:
    assert film_output("minus_log10_ohm", Reading(1e4, 0.0)) == -4.0
    assert film_output("curvature_per_m", Reading(-3.0, 0.0)) == -3.0
    assert math.isnan(film_output("minus_log10_ohm", Reading(-1.0, 0.0)))
    assert math.isnan(film_output("curvature_per_m", Reading(3.0, 0.0, Quality.STALE)))
    assert math.isnan(film_output("curvature_per_m", None))
    assert (column_of("minus_log10_ohm"), column_of("curvature_per_m")) == ("resistance_ohm", "curvature_per_m")


CONFIGURATION = """
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
quantity = "voltage"
output = "curvature_per_m"
formula = "(voltage_V - 0.5) / 0.25"
[limits]
current_A = 4.0
[experiment]
kind = "hold"
[simulation.film]
kind = "model"
model = "film.toml"
[simulation.detector]
volts_per_unit = 0.25
offset_V = 0.5
noise_V = 1e-4
"""
FILM = """
[film]
kind = "generalized_pi"
output = "curvature_per_m"
radii = [0.1]
weights = [2.0]
rising = { function = "tanh", a = 0.1, b = -6.0 }
falling = { function = "tanh", a = 0.1, b = -5.5 }
memoryless = { function = "none", offset = 1.0 }
"""


def test_a_bench_with_a_detector(tmp_path: Path, peltier: Peltier) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(CONFIGURATION)
    (tmp_path / "film.toml").write_text(FILM)
    with open_bench(read_configuration(path)) as bench:
        assert bench.meter is not None
        reading = bench.meter.read()
        assert bench.meter.output == "curvature_per_m"
        assert -1.5 < reading.value < 3.5  # the model's: 1 +- 2
    out = peltier.succeeds("check", path)
    assert "curvature:" in out
    assert "per_m" in out


def test_a_run_records_the_quantity(tmp_path: Path, peltier: Peltier) -> None:
    path = tmp_path / "rig.toml"
    hold = 'kind = "temperature_profile"\nlaw = "instrument_pid"\ntarget = ["start 30 degC", "ramp to 40 degC in 10 s"]'
    path.write_text(CONFIGURATION.replace('kind = "hold"', hold))
    (tmp_path / "film.toml").write_text(FILM)
    peltier.succeeds("run", path, "--out", tmp_path / "out")
    record = read_record(tmp_path / "out" / "record.csv")
    assert record.has("curvature_per_m")
    assert not record.has("resistance_ohm")
    assert "Curvature, temperature, current" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (('quantity = "voltage"\n', ""), "expected with quantity = 'voltage' only"),
        (('formula = "(voltage_V - 0.5) / 0.25"\n', ""), "expected with quantity = 'voltage'"),
        (("(voltage_V - 0.5)", "(volts - 0.5)"), "not allowed"),
        (("curvature_per_m", "current_A"), "a name and its unit"),
    ],
)
def test_faults_of_the_configuration(tmp_path: Path, change: tuple[str, str], expected: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(CONFIGURATION.replace(*change))
    (tmp_path / "film.toml").write_text(FILM)
    with pytest.raises(Faults, match="meter") as found:
        read_configuration(path)
    assert expected in str(found.value)


def test_an_ohmmeter_reads_no_curvature(tmp_path: Path, peltier: Peltier) -> None:
    path = tmp_path / "rig.toml"
    lines = [line for line in CONFIGURATION.splitlines() if not line.startswith(("quantity", "formula", "output"))]
    path.write_text("\n".join(lines))
    (tmp_path / "film.toml").write_text(FILM)
    err = peltier.fails("check", path)
    assert "simulation.film.model: its film's output is 'curvature_per_m'; expected a resistance" in err
