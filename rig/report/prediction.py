"""The report of a prediction: the model's over the measured, the error over time, how often it is how large."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from compensator.hysteresis.functions import Array
from rig.analysis.prediction_error import ChannelError
from rig.core.file_writing import write_text
from rig.records.run_folder import plain_json
from rig.report.figures import saved
from rig.report.model_figures import drawn_over_time, histogram_figure, loop_figure, residual_figure
from rig.report.page import figure, paragraph, section, tiles, write_page


def write_prediction_report(
    folder: Path, result: Mapping[str, Any], time_s: Array, degC: Array, errors: Sequence[ChannelError]
) -> None:
    """report.html, prediction.json and figures/ in a folder that is there."""
    write_text(folder / "prediction.json", plain_json(result) + "\n")
    parts, numbers = [], []
    for one in errors:
        plate = one.name == "temperature_degC"
        numbers += [
            (f"{one.rmse:.4g} {one.unit}", "RMSE of the " + ("temperature" if plate else "film's output")),
            (f"{one.max_abs:.4g} {one.unit}", "largest error"),
        ]
        suffix = "_plate" if plate else ""
        over_time = saved(drawn_over_time(time_s, [one]), folder, f"over_time{suffix}")
        shown = [figure(over_time, "Measured and predicted, over time.")]
        if not plate:
            shown.append(loop_figure(folder, time_s, degC, one.measured, one.predicted, one.name))
        shown += [
            residual_figure(folder, time_s, degC, one.residual, one.unit, suffix),
            histogram_figure(folder, one.residual, one.unit, suffix),
        ]
        parts.append(section("The plate's temperature" if plate else "The film", *shown))
    lead = f"{Path(str(result['model'])).name} against {Path(str(result['record'])).name}."
    if not parts:
        parts.append(paragraph("Nothing to compare: neither readings of the film nor temperature with current."))
    write_page(folder / "report.html", "A prediction beside its record", lead, [tiles(numbers), *parts])
