"""The report of a plain temperature or current profile."""

from __future__ import annotations

import numpy as np

from rig.files.run_folder import RunFolder
from rig.loop import COLUMNS
from rig.report.figures import COLOURS, log_scale, new_figure, saved, thinned
from rig.report.page import facts, figure, tiles, write_page


def temperature_error_K(folder: RunFolder) -> float | None:
    """RMS of measured minus wanted temperature over the profile; None where no temperature was wanted."""
    inside = folder.column("phase") == "profile"
    error = (folder.column("temperature_degC") - folder.column("setpoint_degC"))[inside]
    error = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(error**2))) if error.size else None


def write_profile_report(folder: RunFolder, kind: str) -> None:
    """report.html of a recorded profile."""
    time, temperature, current = (folder.column(n) for n in ("time_s", "temperature_degC", "current_A"))
    film = ["resistance_ohm", *(name for name in folder.columns if name not in COLUMNS)][-1]  # or another quantity
    wanted, readings = folder.column("setpoint_degC"), folder.column(film)
    measured = bool(np.any(np.isfinite(readings)))
    quantity, _, unit = film.partition("_")
    fig, axes = new_figure(3 if measured else 2, 7.0 if measured else 5.0)
    t, shown, reference = thinned(time, temperature, wanted)
    axes[0].plot(t, shown, color=COLOURS["temperature"], label="measured")
    if np.any(np.isfinite(reference)):
        axes[0].plot(t, reference, color=COLOURS["target"], linestyle=(0, (4, 2)), linewidth=1.0, label="wanted")
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    t, shown = thinned(time, current)
    axes[1].step(t, shown, where="post", color=COLOURS["current"], linewidth=0.9)
    axes[1].set_ylabel("current / A")
    if measured:
        t, shown = thinned(time, readings)
        axes[2].plot(t, shown, color=COLOURS["measured"])
        if film == "resistance_ohm":
            log_scale(axes[2])
        axes[2].set_ylabel(f"{quantity} / {unit}")
    axes[-1].set_xlabel("time / s")
    numbers = [(str(len(folder.rows)), "rows"), (f"{float(time[-1]):.0f} s", "duration")]
    error = temperature_error_K(folder)
    if error is not None:
        numbers.append((f"{error * 1e3:.0f} mK" if error < 1.0 else f"{error:.2f} K", "RMS error against the profile"))
    title = {"temperature_profile": "Temperature profile", "current_profile": "Current profile", "hold": "Hold"}[kind]
    caption = "Temperature, current" + (f" and {quantity}." if measured else ".")
    write_page(
        folder.part / "report.html",
        title,
        f"{len(folder.rows)} rows over {float(time[-1]):.0f} s were recorded.",
        [facts(folder), tiles(numbers), figure(saved(fig, folder.part, "courses"), caption)],
    )
