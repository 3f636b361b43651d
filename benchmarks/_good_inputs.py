"""Good inputs for every verb, in a folder: what the mutations begin with."""

from __future__ import annotations

from pathlib import Path

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
    assert peltier(["run", str(folder / "config.toml"), "--out", str(folder / "run")]) in (0, 10)
    (folder / "taken").mkdir()
    (folder / "taken" / "file").write_text("")
    (folder / "link").symlink_to("taken")
    (folder / "dangling").symlink_to("nowhere")


def own_effect() -> str:
    """The example of docs/own_effect.md."""
    return OWN.partition("```python\n")[2].partition("```")[0]
