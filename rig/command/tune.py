"""peltier tune CONFIG: PID gains from the plate model, with gain margin, phase margin and maximum sensitivity."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.command.record_arguments import add_json_argument
from rig.command.say import Voice
from rig.core.faults import fault


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.files.configuration import read_configuration
    from rig.files.model_file import read_model

    voice = Voice(options.json)
    file = read_configuration(options.config)
    if file.content.experiment.model is None:
        raise fault(options.config, "experiment.model", "missing; expected a model file with [plate] (and [film])")
    model = read_model(file.beside(file.content.experiment.model), needs=("plate", "film"))
    from rig.drivers.heater_drive import OF_FULL_DRIVE
    from rig.experiment.summaries import design_table
    from rig.experiment.tracking import law_and_design

    assert model.film is not None
    assert model.plate is not None
    result = {}
    unit = "A" if model.plate.kind == "peltier" else OF_FULL_DRIVE
    for name, what in (("full", "temperature, output in K/s"), ("pid", f"log R, output in {unit}")):
        _, design = law_and_design(name, file.content, model.film, model.plate)  # type: ignore[arg-type]
        gains, margins = design.gains, design.margins
        voice.say(f"{name}: PID on {what}, period {design.period_s:g} s, dead time {design.dead_time_s:g} s")
        voice.say(
            f"  Kp {gains.kp:.5g}   Ki {gains.ki:.5g}   tracking time {gains.tracking_time_s:.3g} s   b {gains.b:g}"
        )
        voice.say(
            f"  gain margin {margins.gain_margin:.2f}   phase margin {margins.phase_margin_deg:.1f} deg   "
            f"Ms {margins.ms:.3f}   crossover {margins.crossover_rad_per_s:.3g} rad/s"
        )
        result[name] = design_table(design)
    voice.report({"format": "peltier-tuning/1", **result})
    return 0
