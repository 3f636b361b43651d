"""The report of a tracking run: did the resistance follow, how, and how much better than the plain laws."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from rig.files.run_folder import RunFolder
from rig.report.figures import COLOURS, log_scale, new_figure, saved, thinned
from rig.report.page import facts, figure, links, paragraph, section, table, tiles, write_page

if TYPE_CHECKING:
    from rig.experiment.session import Result


def write_tracking_report(folder: RunFolder, result: Result, folders: dict[str, RunFolder]) -> None:
    """report.html of one law's folder; `folders` holds the laws that its figures compare, the own one first."""
    own = next(name for name, other in folders.items() if other is folder)
    score = next(s for s in result.scores if s.law == own)
    design = result.designs[own]
    lead = (
        f"The law '{own}' kept the film within {score.rms_dec:.4f} decades RMS of the wanted resistance "
        f"(95 % of the time within {score.p95_dec:.3f}; at worst {score.max_from_start_dec:.3f}, the start included)."
    )
    others = [s for s in result.scores if s.law != own and s.law in folders]
    if others:
        lead += " " + " and ".join(f"{s.rms_dec / score.rms_dec:.1f} times better than '{s.law}'" for s in others) + "."
    margins = design.margins
    numbers = [
        (f"{score.rms_dec:.4f} dec", "RMS tracking error"),
        (f"{score.max_from_start_dec:.3f} dec", "largest error, the start included"),
    ]
    if np.isfinite(score.current_at_limit):
        numbers.append((f"{100 * score.current_at_limit:.0f} %", "of the time the current was at its limit"))
    if own in ("full", "pid"):
        loop = "temperature loop" if own == "full" else "log R loop"
        numbers += [
            (f"{margins.ms:.2f}", f"maximum sensitivity Ms of the {loop}"),
            (f"{margins.phase_margin_deg:.0f}\N{DEGREE SIGN}", "phase margin"),
            (f"{20 * np.log10(margins.gain_margin):.1f} dB", "gain margin"),
        ]
    if result.calibration is not None:
        numbers.append((f"{result.calibration.check_rmse_dec:.4f} dec", "calibration, held-out RMSE"))
    parts = [facts(folder), tiles(numbers), section("Wanted and measured resistance", _courses(folder, folders))]
    parts.append(section("The loop", _loop(folder, own)))
    if len(folders) > 1:
        parts.append(section("The laws on the same target", _laws(result, own), _errors(folder, folders)))
    more = [(f"law {name}", f"{name}/report.html") for name in folders if name != own]
    if result.calibration is not None and len(folders) == len(result.scores):
        more.insert(0, ("calibration", "calibration/report.html"))
    if more:
        parts.append(section("Further reports", links(more)))
    parts.append(section("What the numbers mean", *_meanings(result, own)))
    write_page(folder.part / "report.html", f"{folder.path.name}: tracking a wanted resistance", lead, parts)


def _track(folder: RunFolder) -> dict[str, np.ndarray]:
    inside = folder.column("phase") == "track"
    columns = {
        name: folder.column(name)[inside]
        for name in ("time_s", "temperature_degC", "resistance_ohm", "target_ohm", "current_A", "reference_degC")
    }
    columns["time_s"] = columns["time_s"] - columns["time_s"][0]
    return columns


def _courses(folder: RunFolder, folders: dict[str, RunFolder]) -> str:
    track = _track(folder)
    fig, axes = new_figure(3, 7.6, [2.2, 1.3, 1.0])
    time, measured, target, temperature, reference, current = thinned(
        track["time_s"],
        track["resistance_ohm"],
        track["target_ohm"],
        track["temperature_degC"],
        track["reference_degC"],
        track["current_A"],
    )
    axes[0].plot(time, measured, color=COLOURS["measured"], label="measured", linewidth=1.8)
    axes[0].plot(time, target, color=COLOURS["target"], label="wanted", linestyle=(0, (4, 2)), linewidth=1.1)
    axes[0].set_ylabel("resistance / ohm")
    log_scale(axes[0])
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    if np.any(np.isfinite(reference)):
        axes[1].plot(time, reference, color=COLOURS["target"], linestyle=(0, (4, 2)), linewidth=1.0, label="reference")
    axes[1].plot(time, temperature, color=COLOURS["temperature"], label="measured")
    axes[1].set_ylabel("temperature / \N{DEGREE SIGN}C")
    axes[1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    axes[2].step(time, current, where="post", color=COLOURS["current"], linewidth=0.9)
    axes[2].axhline(0.0, color="#8b94a3", linewidth=0.6)
    axes[2].set_ylabel("current / A")
    axes[2].set_xlabel("time / s")
    return figure(
        saved(fig, folder.part, "courses"),
        "Wanted and measured resistance, the plate's temperature, and the current (positive heats).",
    )


def _loop(folder: RunFolder, own: str) -> str:
    track = _track(folder)
    inside = folder.column("phase") != "track"
    fig, axes = new_figure(1, 4.6)
    before_t, before_r = thinned(folder.column("temperature_degC")[inside], folder.column("resistance_ohm")[inside])
    temperature, measured = thinned(track["temperature_degC"], track["resistance_ohm"])
    axes[0].plot(before_t, before_r, color="#b9c0cc", linewidth=1.0, label="conditioning and approach")
    axes[0].plot(temperature, measured, color=COLOURS.get(own, "#1f5fbf"), linewidth=1.1, label="tracking")
    axes[0].set_xlabel("temperature / \N{DEGREE SIGN}C")
    axes[0].set_ylabel("resistance / ohm")
    log_scale(axes[0])
    axes[0].legend(loc="upper right")
    return figure(
        saved(fig, folder.part, "loop"),
        "Resistance over temperature: every turning point of the target is a minor loop that the inverse had to cross.",
    )


def _laws(result: Result, own: str) -> str:
    mine = next(s for s in result.scores if s.law == own)
    names = {
        "full": "full: inverse, plate inverse, feedback",
        "pid": "pid: on log R alone",
        "feedforward": "feedforward: inverses, no feedback",
        "instrument_pid": "instrument_pid: the controller's own",
    }
    rows = [
        [
            names[s.law],
            f"{s.rms_dec:.4f}",
            f"{s.p95_dec:.4f}",
            f"{s.max_dec:.3f}",
            f"{result.designs[s.law].margins.ms:.2f}" if s.law in ("full", "pid") else "\N{EN DASH}",
            f"{s.rms_dec / mine.rms_dec:.1f} \N{MULTIPLICATION SIGN}",
        ]
        for s in result.scores
    ]
    head = ["law", "RMS / dec", "95 % within / dec", "largest / dec", "Ms", "RMS over that of " + own]
    return table(head, rows, best=[s.law for s in result.scores].index(own))


def _errors(folder: RunFolder, folders: dict[str, RunFolder]) -> str:
    fig, axes = new_figure(len(folders), 1.6 + 1.5 * len(folders))
    for axis, (name, other) in zip(axes, folders.items(), strict=True):
        track = _track(other)
        error = np.log10(track["resistance_ohm"]) - np.log10(track["target_ohm"])
        time, shown = thinned(track["time_s"], error)
        _error_axis(axis, time, shown, name)
    axes[-1].set_xlabel("time / s")
    return figure(
        saved(fig, folder.part, "errors"),
        "Error over time, measured over wanted, in decades. Each law has its own scale; the band is +-0.05 decades.",
    )


def _error_axis(axis: Axes, time: np.ndarray, error: np.ndarray, name: str) -> None:
    axis.axhspan(-0.05, 0.05, color="#eef2f8", zorder=0)
    axis.plot(time, error, color=COLOURS.get(name, "#1f5fbf"), linewidth=1.0)
    axis.set_ylabel(f"{name}\nerror / dec")


def _meanings(result: Result, own: str) -> list[str]:
    texts = [
        "Errors are log10 of measured over wanted resistance, counted after the first tenth of the target; the "
        "first tenth is left to settle. All laws began from the same temperature on the same branch of the loop.",
    ]
    design = result.designs[own]
    if own in ("feedforward", "instrument_pid"):
        loops = {"feedforward": "No loop is closed", "instrument_pid": "The loop is closed by the controller's own PID"}
        texts.append(f"{loops[own]} under this law, so that there are no margins to tell.")
        return [paragraph(text, "note") for text in texts]
    texts.append(
        f"The temperature PID was designed for a largest sensitivity of {design.margins.ms:.2f} with a dead time of "
        f"{design.dead_time_s:g} s at a period of {design.period_s:g} s."
        if own != "pid"
        else f"The PID on log R was designed for a largest sensitivity of {design.margins.ms:.2f} at the film's "
        f"steepest slope, {design.process_gain:.3g} decades per ampere and second."
    )
    if result.calibration is not None:
        texts.append(
            "The controller knows only what the calibration gave: see its report. "
            + "; ".join(result.calibration.film.identifiability[:2])
        )
    return [paragraph(text, "note") for text in texts]
