"""The report of a calibration: the loops, the model over them, the check on held-out rows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compensator.hysteresis.functions import Array
from rig.analysis.film_numbers import numbers_of_run
from rig.analysis.residual import residual_dec, residual_label
from rig.records.run_folder import PREDICTED
from rig.report.figures import BLUE, COLOURS, EDGE, SHADE, draw_line, log_scale, new_figure, saved
from rig.report.identification import transition_section
from rig.report.model_figures import draw_residual
from rig.report.page import bullets, facts, figure, paragraph, section, table, tiles, write_page
from rig.report.run_figures import draw_drive
from rig.report.run_rows import PHASE, RunRows, drive_label
from sim.inference.covariance import NORMAL_95

UNITS = {
    "seebeck_over_capacity_per_A_s": ("S/C", "1/(A s)"),
    "resistance_over_capacity_K_per_A2_s": ("R_e/C", "K/(A\N{SUPERSCRIPT TWO} s)"),
    "conductance_over_capacity_per_s": ("G/C", "1/s"),
    "seebeck_slope_per_K": ("relative slope of S", "1/K"),
    "resistance_slope_per_K": ("relative slope of R_e", "1/K"),
    "drive_over_capacity_K_per_s": ("heating rate at full drive", "K/s"),
    "ambient_degC": ("ambient", "\N{DEGREE SIGN}C"),
}


def write_calibration_report(run: RunRows, out: Path) -> None:
    """report.html of a calibration, in `out`."""
    result = run.document["result"]
    lead = (
        f"The film model predicts log R to {result['check_rmse_dec']:.4f} decades RMS "
        f"(largest {result['check_max_dec']:.3f}) on {result['rows_checked']} rows that it was not fitted to."
    )
    low, high = result["transition_degC"]
    numbers = [
        (f"{result['check_rmse_dec']:.4f} dec", "held-out RMSE of log R"),
        (f"{result['rmse_dec']:.4f} dec", "RMSE of the fit"),
        (f"{result['check_rmse_K'] * 1e3:.0f} mK", f"held-out RMSE of the temperature from the {drive_label(run)[0]}"),
        (f"{low:.0f}\N{EN DASH}{high:.0f} \N{DEGREE SIGN}C", "the transition"),
        (result["memoryless"], "form of D(T)"),
        (str(result["operators"]), "play operators with weight"),
    ]
    rows = [_parameter(one) for one in result["plate"]]
    doubts = result["identifiability"]
    predicted = _predicted(run.part / PREDICTED, run.rows)
    film = [_loops(run, out, predicted)]
    if predicted is not None:
        film.append(_residual(run, out, predicted))
    parts = [
        facts(run),
        tiles(numbers),
        section("The film", *film),
        *([transition_section(out, numbers_of_run(run, run.path.name, result["lag_s"]))] if "lag_s" in result else []),
        section(
            "What this record cannot fix",
            bullets(doubts) if doubts else paragraph("Nothing: it fixes the film and the plate."),
        ),
        section("The plate", table(["parameter", "value", "95 %", "unit"], rows), _profile(run, out)),
    ]
    write_page(out / "report.html", f"{run.path.name}: film and plate", lead, parts)


def _parameter(one: dict[str, Any]) -> list[str]:
    """A row of the plate's table."""
    name, unit = UNITS.get(one["name"], (one["name"], ""))
    error = one["standard_error"]
    interval = f"\N{PLUS-MINUS SIGN} {NORMAL_95 * error:.2g}" if error is not None else "\N{EN DASH}"
    return [name, f"{one['value']:.6g}", interval, unit]


def _predicted(path: Path, rows: int) -> Array | None:
    """The resistance that the model says, ohm, row by row; None where a folder of before has none."""
    from rig.records.record_file import read_record

    if not path.is_file():
        return None
    found = read_record(path, options=False).columns.get("predicted_ohm")
    return found if found is not None and found.size == rows else None


def _loops(run: RunRows, out: Path, predicted: Array | None) -> str:
    fig, axes = new_figure(1, 4.8)
    time, degC, ohm = (run.column(name) for name in ("time_s", "temperature_degC", "resistance_ohm"))
    checked = run.column(PHASE) == "check"
    drawn: list[tuple[Any, Any, str, str, Any]] = [
        (~checked, ohm, EDGE, "fitted rows", "-"),
        (checked, ohm, BLUE, "held-out rows", "-"),
    ]
    if predicted is not None:
        drawn.append((checked, predicted, COLOURS["model"], "model", (0, (2, 2))))
    for rows, values, colour, name, style in drawn:
        draw_line(axes[0], time[rows], values[rows], over=degC[rows], color=colour, linestyle=style, label=name)
    axes[0].set_xlabel("temperature / \N{DEGREE SIGN}C")
    axes[0].set_ylabel("resistance / ohm")
    log_scale(axes[0])
    axes[0].legend(loc="upper right")
    return figure(
        saved(fig, out, "loops"),
        "Major and minor loops, and the model's prediction over the held-out minor loops.",
    )


def _residual(run: RunRows, out: Path, predicted: Array) -> str:
    fig, axes = new_figure(1, 2.4)
    time = run.column("time_s")
    draw_residual(axes[0], time, residual_dec(run.column("resistance_ohm"), predicted))
    checked = time[run.column(PHASE) == "check"]
    axes[0].axvspan(float(checked[0]), float(checked[-1]), color=SHADE, zorder=0)
    axes[0].set_xlabel("time / s")
    axes[0].set_ylabel(residual_label("dec"))
    return figure(
        saved(fig, out, "residual"),
        "The residual of log10 R over time; shaded: held-out rows.",
    )


def _profile(run: RunRows, out: Path) -> str:
    fig, axes = new_figure(2, 4.2, [1.6, 1.0])
    time = run.column("time_s")
    draw_line(axes[0], time, run.column("temperature_degC"), color=COLOURS["temperature"])
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    draw_drive(axes[1], run, time, run.column("current_A"))
    axes[1].set_xlabel("time / s")
    return figure(saved(fig, out, "profile"), "The profile that was run: pulses, major loop, minor loops.")
