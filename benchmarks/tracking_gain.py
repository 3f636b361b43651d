"""What a model with [[effects]] gains in tracking: RMS error with the base model against the extended one.

    ./peltier benchmark tracking_gain

The simulated rig has the effects of each row; film and plate models are its own, so that nothing but the effects is
wrong with the base model. Errors in decades, of the ohmmeter's readings over the whole target.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from rig.config.configuration import ConfigurationFile
from rig.config.effect_tables import parse_effect
from rig.config.model_file import Model, read_model, write_model
from rig.config.toml_file import read_toml
from rig.experiment.session import run
from rig.rehearsal.simulated import simulated_configuration

ROOT = Path(__file__).resolve().parent.parent
MODEL = ROOT / "configs" / "models" / "two_branches.toml"
TARGET = [
    "start 20 kohm",
    "hold 5 s",
    "ramp to 5 kohm at 0.04 dec/s",
    "hold 10 s",
    "ramp to 12 kohm at 0.04 dec/s",
    "sine 0.15 dec period 40 s for 80 s",
    "ramp to 8 kohm at 0.03 dec/s",
    "hold 5 s",
]
CASES = {
    "film_lag 4 s, series_resistance 300 ohm": ["film_lag:tau_s=4", "series_resistance:series_ohm=300"],
    "film_lag 2 s": ["film_lag:tau_s=2"],
    "actuator_delay 1 s": ["actuator_delay:delay_s=1"],
    "sensor_lag 3 s": ["sensor_lag:tau_s=3"],
    "meter_lag 2 s": ["meter_lag:tau_s=2"],
    "timestamp_skew 1.5 s": ["timestamp_skew:skew_s=1.5"],
    "heat_sink_warmup": ["heat_sink_warmup:sink_capacity_ratio=5,sink_conductance_ratio_per_s=0.1"],
    "self_heating 2000 K/W": ["self_heating:theta_K_per_W=2000"],
    "parallel_leakage 100 kohm": ["parallel_leakage:leakage_ohm=1e5"],
    "three lags and a sink": ["film_lag:tau_s=2", "sensor_lag:tau_s=2", "meter_lag:tau_s=1", "heat_sink_warmup"],
}


def rms_dec(folder: Path, effects: list[str], extended: bool, target: list[str] | None = None) -> float:
    """RMS tracking error of the full law on a rig with effects, in decades."""
    tables = [parse_effect(text) for text in effects]
    base = read_model(MODEL)
    write_model(folder / "truth.toml", base)
    file = _configuration(folder, tables, target or TARGET)
    known = _complete(file) if extended else ()
    write_model(folder / "model.toml", Model(base.film, base.plate, known))
    result = run(file, folder / ("extended" if extended else "base"), lambda text: None, None)
    return result.scores[0].rms


def _complete(file: ConfigurationFile) -> tuple[dict[str, float | str], ...]:
    """The simulated effects as a model has them, each with all its parameters."""
    from rig.bench.simulation import simulated_effects

    return tuple({"name": e.name, **e.values()} for e in simulated_effects(file))


def _configuration(folder: Path, tables: list[dict[str, object]], target: list[str]) -> ConfigurationFile:
    path = folder / "config.toml"
    (folder / "model.toml").touch()
    path.write_text((ROOT / "configs" / "effects.toml").read_text())
    raw = read_toml(path)
    raw["experiment"]["target"] = target
    raw["experiment"]["model"] = "model.toml"
    raw["simulation"]["film"]["model"] = "truth.toml"
    raw["simulation"].pop("effects", None)
    return simulated_configuration(path, raw, tables, None)


def main() -> int:
    print(f"{'effects of the rig':42s} {'base model':>12s} {'extended':>12s}   times better")
    for name, effects in CASES.items():
        with tempfile.TemporaryDirectory() as temporary:
            base, extended = (rms_dec(Path(temporary), effects, known) for known in (False, True))
        print(f"{name:42s} {base:12.4f} {extended:12.4f} {base / extended:14.1f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
