"""The report of a prediction: the model's over the measured, the error over time, how often it is how large."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from compensator.hysteresis.functions import Array
from rig.analysis.prediction_error import ChannelError
from rig.files.film_output import in_decades
from rig.files.run_folder import plain_json
from rig.files.written import write_text
from rig.report.figures import COLOURS, log_scale, new_figure, saved, thinned
from rig.report.film_figures import histogram_figure, label_of, loop_figure, residual_figure, shown_output
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
        error, suffix = one.predicted - one.measured, "_plate" if plate else ""
        over_time = saved(drawn_over_time(time_s, [one]), folder, f"over_time{suffix}")
        shown = [figure(over_time, "Measured and predicted, over time.")]
        if not plate:
            shown.append(loop_figure(folder, degC, one.measured, one.predicted, one.name))
        shown += [
            residual_figure(folder, time_s, degC, error, one.unit, suffix),
            histogram_figure(folder, error, one.unit, suffix),
        ]
        parts.append(section("The plate's temperature" if plate else "The film", *shown))
    lead = f"{Path(str(result['model'])).name} against {Path(str(result['record'])).name}."
    if not parts:
        parts.append(paragraph("Nothing to compare: neither readings of the film nor temperature with current."))
    write_page(folder / "report.html", "A prediction beside its record", lead, [tiles(numbers), *parts])


def drawn_over_time(time_s: Array, errors: Sequence[ChannelError]) -> Figure:
    """Measured and predicted over time, a panel for each channel."""
    fig, axes = new_figure(max(1, len(errors)), 3.4 * max(1, len(errors)))
    for axis, error in zip(axes, errors, strict=False):
        plate = error.name == "temperature_degC"
        measured, predicted = error.measured, error.predicted
        if not plate:
            measured, predicted = shown_output(measured, error.name), shown_output(predicted, error.name)
        t, one, other = thinned(time_s, measured, predicted)
        axis.plot(t, one, color=COLOURS["measured"], label="measured")
        axis.plot(t, other, color=COLOURS["model"], linestyle=(0, (3, 2)), label="predicted")
        axis.set_ylabel("temperature / \N{DEGREE SIGN}C" if plate else label_of(error.name))
        if not plate and in_decades(error.name):
            log_scale(axis)
        axis.legend(loc="best")
    axes[-1].set_xlabel("time / s")
    return fig
