"""The report of a calibration: the loops, the model over them, the check on rows that no fit has seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rig.files.run_folder import RunFolder
from rig.report.figures import COLOURS, log_scale, new_figure, saved, thinned
from rig.report.film_section import transition_section
from rig.report.page import bullets, facts, figure, paragraph, section, table, tiles, write_page

if TYPE_CHECKING:
    from rig.experiment.calibration import Calibration


def write_calibration_report(folder: RunFolder, result: Calibration) -> None:
    """report.html of a calibration's folder."""
    film, plate = result.film, result.plate
    lead = (
        f"The film model predicts log R to {result.check_rmse_dec:.4f} decades RMS "
        f"(largest {result.check_max_dec:.3f}) on {result.rows_checked} rows that it was not fitted to."
    )
    numbers = [
        (f"{result.check_rmse_dec:.4f} dec", "held-out RMSE of log R"),
        (f"{film.rmse:.4f} dec", "RMSE of the fit"),
        (f"{result.check_rmse_K * 1e3:.0f} mK", "held-out RMSE of the temperature from the current alone"),
        (
            f"{result.transition_degC[0]:.0f}\N{EN DASH}{result.transition_degC[1]:.0f} \N{DEGREE SIGN}C",
            "the transition",
        ),
        (film.model.memoryless.function, "form of D(T)"),
        (f"{int(np.sum(film.model.weights > 0.0))}", "play operators with weight"),
    ]
    units = {
        "seebeck_over_capacity_per_A_s": ("S/C", "1/(A s)"),
        "resistance_over_capacity_K_per_A2_s": ("R_e/C", "K/(A\N{SUPERSCRIPT TWO} s)"),
        "conductance_over_capacity_per_s": ("G/C", "1/s"),
        "drive_over_capacity_K_per_s": ("heating rate at full drive", "K/s"),
        "ambient_degC": ("ambient", "\N{DEGREE SIGN}C"),
    }
    rows = [
        [units[name][0], f"{value:.6g}", f"\N{PLUS-MINUS SIGN} {1.96 * error:.2g}", units[name][1]]
        for name, value, error in zip(plate.names, plate.values, plate.standard_errors, strict=True)
    ]
    open_questions = [*film.identifiability, *plate.identifiability]
    parts = [
        facts(folder),
        tiles(numbers),
        section("The film", _loops(folder, result), _residual(folder, result)),
        *([transition_section(folder.part, result.numbers)] if result.numbers is not None else []),
        section(
            "What this record cannot fix",
            bullets(open_questions) if open_questions else paragraph("Nothing: it fixes the film and the plate."),
        ),
        section("The plate", table(["parameter", "value", "95 %", "unit"], rows), _profile(folder)),
    ]
    write_page(folder.part / "report.html", f"{folder.path.name}: film and plate", lead, parts)


def _loops(folder: RunFolder, result: Calibration) -> str:
    fig, axes = new_figure(1, 4.8)
    temperature, resistance = folder.column("temperature_degC"), folder.column("resistance_ohm")
    checked = folder.column("phase") == "check"
    for inside, colour, name in ((~checked, "#9fb6d8", "fitted rows"), (checked, COLOURS["measured"], "held-out rows")):
        t, r = thinned(temperature[inside], resistance[inside])
        axes[0].plot(t, r, color=colour, linewidth=1.2, label=name)
    t, predicted = thinned(temperature[checked], 10.0 ** -result.predicted_output[checked])
    axes[0].plot(t, predicted, color=COLOURS["model"], linewidth=1.4, linestyle=(0, (2, 2)), label="model")
    axes[0].set_xlabel("temperature / \N{DEGREE SIGN}C")
    axes[0].set_ylabel("resistance / ohm")
    log_scale(axes[0])
    axes[0].legend(loc="upper right")
    return figure(
        saved(fig, folder.part, "loops"),
        "Major and minor loops, and the model's prediction over the held-out minor loops.",
    )


def _residual(folder: RunFolder, result: Calibration) -> str:
    fig, axes = new_figure(1, 2.4)
    time, resistance = folder.column("time_s"), folder.column("resistance_ohm")
    error = result.predicted_output + np.log10(resistance)
    t, shown = thinned(time, error)
    axes[0].plot(t, shown, color=COLOURS["model"], linewidth=0.8)
    checked = time[folder.column("phase") == "check"]
    axes[0].axvspan(float(checked[0]), float(checked[-1]), color="#eef2f8", zorder=0)
    axes[0].set_xlabel("time / s")
    axes[0].set_ylabel("model - measured / dec")
    return figure(saved(fig, folder.part, "residual"), "What the film model gets wrong; shaded: held-out rows.")


def _profile(folder: RunFolder) -> str:
    fig, axes = new_figure(2, 4.2, [1.6, 1.0])
    time, temperature, current = thinned(
        folder.column("time_s"), folder.column("temperature_degC"), folder.column("current_A")
    )
    axes[0].plot(time, temperature, color=COLOURS["temperature"])
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    axes[1].step(time, current, where="post", color=COLOURS["current"], linewidth=0.8)
    axes[1].set_ylabel("current / A")
    axes[1].set_xlabel("time / s")
    return figure(saved(fig, folder.part, "profile"), "The profile that was run: pulses, major loop, minor loops.")
