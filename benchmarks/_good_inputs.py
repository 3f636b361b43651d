"""Good inputs for every verb, in a folder: what the mutations begin with."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from benchmarks._mutated_tables import matlab, workbook
from rig.__main__ import main as peltier

ROOT = Path(__file__).resolve().parents[1]
MODEL = """[film]
kind = "extended_generalized_pi"
output = "minus_log10_ohm"
radii = [0.05, 0.2, 0.5]
weights = [0.4, 0.3, 0.2]
initial = "cooled"
[film.rising]
function = "tanh"
a = 0.2
b = -12.6
[film.falling]
function = "tanh"
a = 0.2
b = -11.8
[film.memoryless]
function = "tanh"
amplitude = 0.4
a = 0.03
b = -1.6
offset = -4.0
[plate]
kind = "peltier"
seebeck_over_capacity_per_A_s = 1.6e-3
resistance_over_capacity_K_per_A2_s = 0.06
conductance_over_capacity_per_s = 0.018
ambient_degC = 25.0
[[effects]]
name = "film_lag"
tau_s = 2.0
"""
BENCH = """[bench]
time = "virtual"
[bench.controller]
driver = "meerstetter"
port = "sim://"
baud = 57600
dead_man_s = 5.0
[bench.meter]
driver = "keithley2000"
port = "sim://"
nplc = 1.0
[limits]
temperature_degC = [10, 95]
current_A = 4.0
meter_current_A = 1e-3
stale_s = 2.0
rate_K_per_s = 20.0
runaway_s = 20.0
polarity_share = 0.0
[experiment]
kind = "{kind}"
name = "film-7"
target = {target}
model = "model.toml"
law = "full"
period_s = 0.1
settle_s = 0.5
[control]
ms = 1.4
preview_s = 2.0
[calibration]
rate_K_per_s = 5.0
minor_loops = 2
[simulation]
first_degC = 60.0
seed = 1
[simulation.film]
kind = "preisach"
relays = 20
[[simulation.effects]]
name = "film_lag"
tau_s = 2.0
[sweep]
seeds = 1
[sweep.parameters]
"control.ms" = [1.4]
[serve]
port = 0
folder = "kept"
token = "a token of many letters"
hosts = ["https://bench.lab.example"]
"""
TRACK = '["start 20 kohm", "hold 1 s", "ramp to 15 kohm at 0.5 dec/s"]'
RIGS = {  # other instruments: [bench.controller], [bench.meter], each with the options that it has
    "lakeshore": (
        'driver = "lakeshore"\nport = "sim://"\n'
        'options = {input = "A", output = 1, range = "high", max_current_A = 1.0}',
        'driver = "hp34401a"\nport = "sim://"\noptions = {first_range_ohm = 1e5}',
    ),
    "tclab": (
        'driver = "tclab"\nport = "sim://"\noptions = {heater = 1, full_pwm = 200, boot_s = 1.0, agreement_K = 1.0}',
        'driver = "keithley2400"\nport = "sim://"\noptions = {output_between_readings = true}',
    ),
    "te_technology": (
        'driver = "te_technology"\nport = "sim://"\noptions = {model = "tc-48-20", drain_s = 2.0, units = "degC"}',
        'driver = "keithley2450"\nport = "sim://"\nquantity = "voltage"\nrange_V = 10.0\noutput = "curvature_per_m"\n'
        'formula = "(voltage_V - 0.131) * 22.4"',
    ),
    "srs": (
        'driver = "srs_ldc500"\nport = "sim://"\noptions = {heating_sign = 1, framing = "8N1"}\n'
        'serial_number = "098023"',
        'driver = "keithley2000"\nport = "sim://"\noptions = {framing = "7E1"}\nserial_number = "1234567"',
    ),
    "visa": (
        'driver = "lakeshore"\nport = "visa://ASRL/dev/nothing::INSTR"\nbaud = 57600',
        'driver = "keithley2450"\nport = "visa://TCPIP0::127.0.0.1::9::SOCKET"',
    ),
}
OTHER_BENCH = """[bench]
[bench.controller]
{controller}
[bench.meter]
{meter}
[limits]
temperature_degC = [10, 95]
current_A = 0.9
polarity_share = 0.1
[experiment]
kind = "current_profile"
target = ["start 0 A", "ramp to 0.5 A in 2 s"]
period_s = 0.25
settle_s = 0.5
"""
OWN = (ROOT / "docs" / "own_effect.md").read_text(encoding="utf-8")


def lay_out(folder: Path) -> None:
    """Good inputs for every verb."""
    (folder / "model.toml").write_text(MODEL)
    (folder / "own.py").write_text(own_effect())
    (folder / "config.toml").write_text(BENCH.format(kind="track_resistance", target=TRACK))
    (folder / "profile.toml").write_text(BENCH.format(kind="temperature_profile", target='"target.csv"'))
    (folder / "current.toml").write_text(
        BENCH.format(kind="current_profile", target='["start 0 A", "ramp to 1 A in 4 s"]')
    )
    rows = [f"{t},{60 + 0.2 * t:.3f},{20_000 - 50 * t},{0.1 * t:.2f}" for t in range(20)]
    (folder / "target.csv").write_text("time_s,setpoint_degC,target_ohm,current_A\n" + "\n".join(rows) + "\n")
    said = peltier(["simulate", str(folder / "current.toml"), "--out", str(folder / "record.csv")])
    assert said == 0
    lines = (folder / "record.csv").read_text().splitlines(keepends=True)
    (folder / "short.csv").write_text("".join(lines[:13]))
    lay_out_tables(folder)
    for name, (controller, meter) in RIGS.items():
        (folder / f"{name}.toml").write_text(OTHER_BENCH.format(controller=controller, meter=meter))
    assert peltier(["run", str(folder / "config.toml"), "--out", str(folder / "run")]) in (0, 10)
    (folder / "taken").mkdir()
    (folder / "taken" / "file").write_text("")
    (folder / "link").symlink_to("taken")
    (folder / "dangling").symlink_to("nowhere")


def lay_out_tables(folder: Path) -> None:
    """The record in the other forms in which labs write one."""
    lines = list(csv.reader((folder / "record.csv").read_text().splitlines()))
    rows = [[float(field) if field else None for field in line] for line in lines[1:]]
    (folder / "record.xlsx").write_bytes(workbook([lines[0], *rows]))
    columns = {name: np.array([row[k] for row in rows], dtype=float) for k, name in enumerate(lines[0])}
    (folder / "record.mat").write_bytes(matlab(columns))
    dated = ["Datum;Zeit;Temperatur (°C);Widerstand (kΩ);Strom (A)"]
    for k in range(40):
        comma = f"{40 + 0.3 * k:.2f};{20 - 0.05 * k:.3f};{0.02 * k:.2f}".replace(".", ",")
        dated.append(f"23.11.2026;10:00:{k:02d};{comma}")
    text = "\r\n".join(dated) + "\r\n"
    (folder / "wide.txt").write_bytes(text.encode("utf-16"))
    (folder / "western.txt").write_bytes(text.replace("Ω", "Ohm").encode("cp1252"))


def own_effect() -> str:
    """The example of docs/own_effect.md."""
    return OWN.partition("```python\n")[2].partition("```")[0]
