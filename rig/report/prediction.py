"""The report of a prediction: the model's over the measured, the error over time, how often it is how large."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.files.film_output import in_decades, unit_of
from rig.files.run_folder import plain_json
from rig.files.written import write_text
from rig.report.figures import COLOURS, log_scale, new_figure, saved, thinned
from rig.report.film_figures import histogram_figure, label_of, loop_figure, residual_figure, shown_output
from rig.report.page import figure, paragraph, section, tiles, write_page


def write_prediction_report(
    folder: Path, result: Mapping[str, Any], time_s: Array, degC: Array, channels: Mapping[str, tuple[Array, Array]]
) -> None:
    """report.html, prediction.json and figures/ in a folder that is there. channels: (measured, predicted) by the
    film's output, and by "temperature_degC" for the plate."""
    write_text(folder / "prediction.json", plain_json(result) + "\n")
    parts, numbers = [], []
    for name, (measured, predicted) in channels.items():
        error = predicted - measured
        plate = name == "temperature_degC"
        unit = "K" if plate else unit_of(name)
        if not np.any(np.isfinite(error)):
            continue
        numbers += [
            (f"{result[f'rmse_{unit}']:.4g} {unit}", "RMSE of the " + ("temperature" if plate else "film's output")),
            (f"{result[f'max_abs_{unit}']:.4g} {unit}", "largest error"),
        ]
        suffix = "_plate" if plate else ""
        shown = [_over_time(folder, time_s, measured, predicted, name, suffix)]
        if not plate:
            shown.append(loop_figure(folder, degC, measured, predicted, name))
        shown += [
            residual_figure(folder, time_s, degC, error, unit, suffix),
            histogram_figure(folder, error, unit, suffix),
        ]
        parts.append(section("The plate's temperature" if plate else "The film", *shown))
    lead = f"{Path(str(result['model'])).name} against {Path(str(result['record'])).name}."
    if not parts:
        parts.append(paragraph("Nothing to compare: neither readings of the film nor temperature with current."))
    write_page(folder / "report.html", "A prediction beside its record", lead, [tiles(numbers), *parts])


def _over_time(folder: Path, time_s: Array, measured: Array, predicted: Array, name: str, suffix: str) -> str:
    plate = name == "temperature_degC"
    fig, axes = new_figure(1, 3.4)
    if not plate:
        measured, predicted = shown_output(measured, name), shown_output(predicted, name)
    t, one, other = thinned(time_s, measured, predicted)
    axes[0].plot(t, one, color=COLOURS["measured"], label="measured")
    axes[0].plot(t, other, color=COLOURS["model"], linestyle=(0, (3, 2)), label="predicted")
    axes[0].set_xlabel("time / s")
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C" if plate else label_of(name))
    if not plate and in_decades(name):
        log_scale(axes[0])
    axes[0].legend(loc="best")
    return figure(saved(fig, folder, f"over_time{suffix}"), "Measured and predicted, over time.")
