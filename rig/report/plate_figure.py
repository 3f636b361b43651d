"""A plate's record: its temperature beside the model's, what the model gets wrong, and what drove it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from compensator.hysteresis.functions import Array
from rig.report.figures import COLOURS, new_figure, saved, thinned
from rig.report.page import figure


@dataclass(frozen=True, eq=False)
class ComparedPlate:
    """A record beside the plate that was fitted, arrays of shape (rows,): s, degC measured and simulated (nan where no
    stretch of the fit goes), drive in A or, where `drive` is set, as a share of full drive."""

    source: str
    time_s: Array
    measured_degC: Array
    simulated_degC: Array
    drive_A: Array
    drive: str | None


def plate_figure(folder: Path, one: ComparedPlate, suffix: str = "") -> str:
    """Measured and simulated over time, the difference, and the drive."""
    fig, axes = new_figure(3, 6.4, [3.0, 1.6, 1.4])
    t, measured, simulated = thinned(one.time_s, one.measured_degC, one.simulated_degC)
    axes[0].plot(t, measured, color=COLOURS["measured"], label="measured")
    axes[0].plot(t, simulated, color=COLOURS["model"], linestyle=(0, (4, 2)), linewidth=1.0, label="model")
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    axes[1].plot(t, simulated - measured, ".", markersize=2, color=COLOURS["model"])
    axes[1].set_ylabel("model - measured / K")
    t, drive = thinned(one.time_s, one.drive_A)
    axes[2].step(t, drive, where="post", color=COLOURS["current"], linewidth=0.9)
    axes[2].set_ylabel("current / A" if one.drive is None else "drive / of full drive")
    axes[2].set_xlabel("time / s")
    return figure(saved(fig, folder, f"plate{suffix}"), "The plate's temperature, simulated from its drive alone.")
