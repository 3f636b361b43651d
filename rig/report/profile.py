"""The report of a plain temperature or current profile."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rig.analysis.score import COUNTED, largest, profile_error, rms
from rig.core.columns import OF_A_RUN
from rig.report.error_course import kelvin_figure
from rig.report.figures import COLOURS, log_scale, new_figure, saved, thinned
from rig.report.page import facts, figure, section, tiles, write_page
from rig.report.run_rows import RunRows, drive_label

TITLES = {"temperature_profile": "temperature profile", "current_profile": "{drive} profile", "hold": "hold"}


def write_profile_report(run: RunRows, out: Path) -> None:
    """report.html of a recorded profile, in `out`."""
    seconds = float(run.column("time_s")[-1])
    numbers = [(str(run.rows), "rows"), (f"{seconds:.0f} s", "duration")]
    _, error = profile_error(run)
    lead = f"{run.rows} rows over {seconds:.0f} s were recorded."
    parts = [section("Courses", courses(run, out))]
    if np.any(np.isfinite(error)):
        numbers += [(kelvin(rms(error)), f"RMS error {COUNTED}"), (kelvin(largest(error)), "the largest error of it")]
        lead = f"The temperature was within {kelvin(rms(error))} RMS of the wanted one {COUNTED}. {lead}"
        parts.append(section("The error", kelvin_figure(out, run)))
    title = TITLES[run.document["start"]["what"]].format(drive=drive_label(run)[0])
    write_page(out / "report.html", f"{run.path.name}: {title}", lead, [facts(run), tiles(numbers), *parts])


def kelvin(error_K: float) -> str:
    """A temperature error with its unit."""
    return f"{error_K * 1e3:.0f} mK" if error_K < 1.0 else f"{error_K:.2f} K"


def courses(run: RunRows, out: Path) -> str:
    """Temperature, drive and, where it was read, the film over the whole run, wanted beside measured."""
    time, temperature, current = (run.column(n) for n in ("time_s", "temperature_degC", "current_A"))
    own = [name for name in run.columns if name not in OF_A_RUN and not name.startswith(("target_", "predicted_"))]
    film = ["resistance_ohm", *own][-1]  # or another quantity that the meter's voltage stands for
    readings, wanted = run.column(film), run.column("setpoint_degC")
    measured = bool(np.any(np.isfinite(readings)))
    quantity, _, unit = film.partition("_")
    fig, axes = new_figure(3 if measured else 2, 7.0 if measured else 5.0)
    t, shown, reference = thinned(time, temperature, wanted)
    axes[0].plot(t, shown, color=COLOURS["temperature"], label="measured")
    if np.any(np.isfinite(reference)):
        axes[0].plot(t, reference, color=COLOURS["target"], linestyle=(0, (4, 2)), linewidth=1.0, label="wanted")
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    drive, drive_unit = drive_label(run)
    t, shown = thinned(time, current)
    axes[1].step(t, shown, where="post", color=COLOURS["current"], linewidth=0.9)
    axes[1].set_ylabel(f"{drive} / {drive_unit}")
    if measured:
        wanted = run.column("target_ohm" if film == "resistance_ohm" else f"target_{film}")
        t, shown, reference = thinned(time, readings, wanted)
        axes[2].plot(t, shown, color=COLOURS["measured"], label="measured")
        if film == "resistance_ohm":
            log_scale(axes[2])
        if np.any(np.isfinite(reference)):
            style = (0, (4, 2))
            axes[2].plot(t, reference, color=COLOURS["target"], linestyle=style, linewidth=1.0, label="wanted")
        axes[2].set_ylabel(f"{quantity} / {unit}")
    axes[-1].set_xlabel("time / s")
    caption = f"Temperature, {drive}" + (f" and {quantity}." if measured else ".")
    return figure(saved(fig, out, "courses"), caption)
