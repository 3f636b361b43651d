"""The report of a tracking run: did the film's output follow, how, and how much better than the plain laws."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.analysis.score import COUNTED, TRACK, Score, Tracked, score, shown_error, tracked
from rig.report.figures import COLOURS, EDGE, draw_line, log_scale, new_figure, saved
from rig.report.page import facts, figure, links, paragraph, section, table, tiles, write_page
from rig.report.run_figures import draw_drive, draw_measured_and_wanted, tracking_figure
from rig.report.run_rows import CALIBRATION, LAW, RunRows, drive_label, limit_A


def write_tracking_report(run: RunRows, out: Path, inner: Mapping[str, RunRows]) -> None:
    """report.html of one law's run in `out`; inner: its calibration and the laws to compare with, by name."""
    own, what = law_of(run), tracked(run)
    runs = {own: run, **{name: other for name, other in inner.items() if name != CALIBRATION}}
    found = {name: score(one, name, limit_A(one)) for name, one in runs.items()}
    scores = {name: one for name, one in found.items() if one is not None}
    mine, design = scores[own], run.document["result"]["design"]
    calibration = inner[CALIBRATION].document.get("result") if CALIBRATION in inner else None
    parts = [
        facts(run),
        tiles(_numbers(run, mine, design, calibration)),
        section(f"Wanted and measured {what.name}", _courses(run, what, out)),
        section("The error", tracking_figure(out, {name: runs[name] for name in scores})),
        section("The loop", _loop(run, what, out, own)),
    ]
    if len(scores) > 1:
        parts.append(section("The laws on the same target", _laws(runs, scores, own)))
    parts += further(out, inner)
    parts.append(section("What the numbers mean", *_meanings(run, own, design, calibration)))
    lead = (
        f"The law '{own}' kept the film within {_error(mine.rms, mine, 4)} RMS of the wanted {what.name} {COUNTED} "
        f"(95 % of it within {_error(mine.p95, mine, 3)}; at worst {_error(mine.max, mine, 3)}, "
        f"at {mine.max_at_s:.1f} s)."
    )
    others = {name: one.rms / mine.rms for name, one in scores.items() if name != own}
    if others:
        lead += " " + " and ".join(f"{times:.1f} times better than '{name}'" for name, times in others.items()) + "."
    write_page(out / "report.html", f"{run.path.name}: tracking a wanted {what.name}", lead, parts)


def _error(error: float, of: Score, digits: int) -> str:
    return shown_error(error, of.unit, digits).replace(" dec", " decades")


def law_of(run: RunRows) -> str:
    """The law that a tracking run followed its target with."""
    return str(run.document["start"]["what"]).removeprefix(LAW)


def further(out: Path, inner: Mapping[str, RunRows]) -> list[str]:
    """A section with links to the reports of the runs inside this one's folder."""
    if not inner:
        return []
    texts = [name if name.startswith(CALIBRATION) else f"{LAW}{name}" for name in inner]
    addresses = [Path(os.path.relpath(one.part / "report.html", out)).as_posix() for one in inner.values()]
    return [section("Further reports", links(zip(texts, addresses, strict=True)))]


def _numbers(
    run: RunRows, mine: Score, design: Mapping[str, Any], calibration: Mapping[str, Any] | None
) -> list[tuple[str, str]]:
    numbers = [
        (shown_error(mine.rms, mine.unit, 4), f"RMS error {COUNTED}"),
        (shown_error(mine.max, mine.unit, 3), f"the largest error of it, at {mine.max_at_s:.1f} s"),
    ]
    if math.isfinite(mine.current_at_limit):
        share = 100 * mine.current_at_limit
        numbers.append((f"{share:.0f} %", f"of the time the {drive_label(run)[0]} was at its limit"))
    if mine.law in ("full", "pid"):
        output = "log R" if mine.unit == "dec" else "output"
        loop, margins = ("temperature loop" if mine.law == "full" else f"{output} loop"), design["margins"]
        numbers += [
            (f"{margins['ms']:.2f}", f"maximum sensitivity Ms of the {loop}"),
            (f"{margins['phase_margin_deg']:.0f}\N{DEGREE SIGN}", "phase margin"),
            (f"{20 * math.log10(float(margins['gain_margin'])):.1f} dB", "gain margin"),
        ]
    if calibration is not None:
        numbers.append((f"{calibration['check_rmse_dec']:.4f} dec", "calibration, held-out RMSE"))
    return numbers


def _track(run: RunRows, what: Tracked) -> dict[str, Any]:
    inside = run.column("phase") == TRACK
    names = ("time_s", "temperature_degC", what.measured, what.wanted, "current_A", "reference_degC")
    columns = {name: run.column(name)[inside] for name in names}
    columns["time_s"] = columns["time_s"] - columns["time_s"][0]
    return columns


def _label(what: Tracked) -> str:
    return f"{what.name} / {'ohm' if what.in_ohm else what.unit}"


def _courses(run: RunRows, what: Tracked, out: Path) -> str:
    track = _track(run, what)
    time = track["time_s"]
    fig, axes = new_figure(3, 7.6, [2.2, 1.3, 1.0])
    draw_measured_and_wanted(axes[0], time, track[what.measured], track[what.wanted], COLOURS["measured"])
    axes[0].set_ylabel(_label(what))
    if what.in_ohm:
        log_scale(axes[0])
    degC, reference = track["temperature_degC"], track["reference_degC"]
    draw_measured_and_wanted(axes[1], time, degC, reference, COLOURS["temperature"])
    axes[1].set_ylabel("temperature / \N{DEGREE SIGN}C")
    draw_drive(axes[2], run, time, track["current_A"])
    axes[2].set_xlabel("time of the target / s")
    return figure(
        saved(fig, out, "courses"),
        f"Wanted and measured {what.name} and temperature, and the {drive_label(run)[0]} (positive heats).",
    )


def _loop(run: RunRows, what: Tracked, out: Path, own: str) -> str:
    inside = run.column("phase") != TRACK
    fig, axes = new_figure(1, 4.6)
    for rows, colour, name in (
        (inside, EDGE, "conditioning and approach"),
        (~inside, COLOURS.get(own, COLOURS["measured"]), "tracking"),
    ):
        time, degC, shown = (run.column(each)[rows] for each in ("time_s", "temperature_degC", what.measured))
        draw_line(axes[0], time, shown, over=degC, color=colour, linewidth=1.1, label=name)
    axes[0].set_xlabel("temperature / \N{DEGREE SIGN}C")
    axes[0].set_ylabel(_label(what))
    if what.in_ohm:
        log_scale(axes[0])
    axes[0].legend(loc="best")
    return figure(
        saved(fig, out, "loop"),
        f"{what.name.capitalize()} over temperature: every turning point of the target is a minor loop that the "
        "inverse had to cross.",
    )


def _laws(runs: Mapping[str, RunRows], scores: Mapping[str, Score], own: str) -> str:
    unit = scores[own].unit
    names = {
        "full": "full: inverse, plate inverse, feedback",
        "pid": "pid: on log R alone" if unit == "dec" else "pid: on the output alone",
        "feedforward": "feedforward: inverses, no feedback",
        "instrument_pid": "instrument_pid: the controller's own",
    }
    margins = {law: runs[law].document["result"]["design"]["margins"] for law in scores if law in ("full", "pid")}
    rows = [
        [
            names.get(law, law),
            shown_error(one.rms, unit, 4).split()[0],
            shown_error(one.p95, unit, 4).split()[0],
            shown_error(one.max, unit, 3).split()[0],
            f"{margins[law]['ms']:.2f}" if law in margins else "\N{EN DASH}",
            f"{one.rms / scores[own].rms:.1f} \N{MULTIPLICATION SIGN}",
        ]
        for law, one in scores.items()
    ]
    head = ["law", f"RMS / {unit}", f"95 % within / {unit}", f"largest / {unit}", "Ms", "RMS over that of " + own]
    return table(head, rows, best=0)


def _meanings(run: RunRows, own: str, design: Mapping[str, Any], calibration: Mapping[str, Any] | None) -> list[str]:
    in_ohm = tracked(run).in_ohm
    what = f"measured - wanted {'log10 R' if in_ohm else tracked(run).name}"
    texts = [
        f"Errors are {what}, counted {COUNTED}; conditioning, the way to the first "
        "value and the time to settle on it come before. All laws began from the same temperature on the same branch "
        "of the loop.",
    ]
    if own in ("feedforward", "instrument_pid"):
        loops = {"feedforward": "No loop is closed", "instrument_pid": "The loop is closed by the controller's own PID"}
        texts.append(f"{loops[own]} under this law, so that there are no margins to report.")
        return [paragraph(text, "note") for text in texts]
    ms, unit = f"{design['margins']['ms']:.2f}", drive_label(run)[1].replace("of full", "full")
    texts.append(
        f"The temperature PID was designed for a largest sensitivity of {ms} with a dead time of "
        f"{design['dead_time_s']:g} s at a period of {design['period_s']:g} s."
        if own != "pid"
        else f"The PID on {'log R' if in_ohm else 'the output'} was designed for a largest sensitivity of {ms} at the "
        f"film's steepest slope" + (f", {design['process_gain']:.3g} decades per {unit} and second." if in_ohm else ".")
    )
    if calibration is not None:
        doubts = "; ".join(calibration.get("identifiability", [])[:2])
        texts.append(f"The controller knows only what the calibration gave: see its report. {doubts}")
    return [paragraph(text, "note") for text in texts]
