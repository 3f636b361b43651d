"""Pages of one run: tracking, calibration, a plain profile, and whatever ended early, with their figures."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.error import (
    COUNTED,
    OF_MODEL,
    OF_TARGET,
    TRACK,
    Score,
    Tracked,
    in_brackets,
    judgement,
    percent,
    residual_dec,
    residual_label,
    score,
    shown_error,
    target_error,
    tracked,
)
from rig.core.reading import OF_A_RUN
from rig.records.record_file import read_record
from rig.records.run_folder import (
    CALIBRATION,
    LAW,
    PHASE,
    PREDICTED,
    RunRows,
    drive_label,
    ended_early,
    inner_runs,
    limit_A,
)
from rig.report import page
from rig.report.model_pages import NOT_DETERMINED, draw_residual, plate_table, transition_section
from sim.inference.covariance import NORMAL_95

BAND_DEC = 0.05  # 12 % of the resistance: what the eye does not see in a transition of decades
LONGEST = 160  # characters of an event
LAST_EVENTS = 12  # what led to the end, on half a screen
TITLES = {"current_profile": "{drive} profile"}  # else the kind's own name


def write_run_page(run: RunRows, out: Path) -> None:
    """Write report.html and figures/ of a run into a folder that is there. Raises Faults if its rows cannot be read."""
    what = str(run.document["start"]["what"])
    inner = inner_runs(run.part, run.document["start"]["settings"])
    if ended_early(run):
        _write_ended_page(run, out, inner)
    elif what == CALIBRATION:
        _write_calibration_page(run, out)
    elif what.startswith(LAW):
        _write_tracking_page(run, out, inner)
    else:
        _write_profile_page(run, out)


def _error_figure(out: Path, runs: Mapping[str, RunRows]) -> str:
    """Draw the error of the first run on its own scale and, if there are others, of all on one scale, by the names of
    their laws; return the page's figure."""
    panels = [dict(list(runs.items())[:1]), *([dict(runs)] if len(runs) > 1 else [])]
    fig, axes = page.new_figure(len(panels), 1.6 + 1.7 * len(panels))
    several = [(axis, *one) for axis, of in zip(axes, panels, strict=True) for one in reversed(of.items())]
    for axis, law, run in several:
        found = target_error(run)
        assert found is not None
        in_decades, kelvin = found.unit == "dec", found.unit == "K"
        if in_decades:
            axis.axhspan(-BAND_DEC, BAND_DEC, color=page.SHADE, zorder=0)
        colour = page.COLOURS.get("temperature" if kelvin else law, page.COLOURS["measured"])
        axis.axhline(0.0, color=page.EDGE, linewidth=0.6)
        page.draw_line(axis, found.time_s, found.error, color=colour, linewidth=1.0, label=law)
        k = int(np.nanargmax(np.abs(found.error)))  # a dot where it is largest
        axis.plot(found.time_s[k : k + 1], found.error[k : k + 1], "o", color=colour, markersize=4)
        axis.set_ylabel(f"measured\n- wanted / {found.unit}")
    if len(panels) > 1:
        axes[0].set_title(f"the law {next(iter(runs))} alone", fontsize=10, loc="left")
        page.legend_above(axes[-1])
    axes[-1].set_xlabel("time of the target / s")
    what = "temperature" if kelvin else "log10 R" if in_decades else tracked(run).name
    text = f"The error over time, measured - wanted {what}."
    text += " Below, all laws on one scale." * (len(runs) > 1)
    text += f" Shaded: ± {BAND_DEC:g} decades." * in_decades
    return page.saved(fig, out, "errors", text)


def _courses(run: RunRows, out: Path, phase: str | None = None) -> str:
    """Draw temperature, drive and, if it was read, the film, of a phase or the whole run; return the page's figure."""
    inside = run.column(PHASE) == phase if phase is not None else np.full(run.rows, True)
    time, degC, current = (run.column(name)[inside] for name in ("time_s", "temperature_degC", "current_A"))
    own = [name for name in run.columns if name not in OF_A_RUN and not name.startswith(("target_", "predicted_"))]
    film = ["resistance_ohm", *own][-1]  # or another quantity that the meter's voltage stands for
    readings, wanted = run.column(film)[inside], run.column("setpoint_degC" if phase is None else "reference_degC")
    measured, wanted = bool(np.any(np.isfinite(readings))), wanted[inside]
    fig, axes = page.new_figure(3, 7.6, [2.2, 1.3, 1.0]) if measured else page.new_figure(2, 5.0)
    time = time if phase is None else time - time[0]
    drive, unit = drive_label(run)
    panels = [(axes[-2], degC, wanted, "temperature / \N{DEGREE SIGN}C", page.COLOURS["temperature"])]
    if measured:
        target = run.column("target_ohm" if film == "resistance_ohm" else f"target_{film}")[inside]
        panels.append((axes[0], readings, target, film.replace("_", " / ", 1), page.COLOURS["measured"]))
        if film == "resistance_ohm":
            page.log_scale(axes[0])
    for axis, read, asked, label, colour in panels:
        page.draw_line(axis, time, read, color=colour, label="measured", linewidth=1.5)
        if np.any(np.isfinite(asked)):
            style: dict[str, Any] = {"color": page.COLOURS["target"], "linestyle": (0, (4, 2)), "linewidth": 1.1}
            page.draw_line(axis, time, asked, label="wanted", **style)
            page.legend_above(axis)
        axis.set_ylabel(label)
    axes[-1].axhline(0.0, color=page.EDGE, linewidth=0.6)
    page.draw_line(axes[-1], time, current, held=True, color=page.COLOURS["current"], linewidth=0.9)
    axes[-1].set(xlabel="time / s" if phase is None else "time of the target / s", ylabel=f"{drive} / {unit}")
    names = [*([film.partition("_")[0]] if measured else []), "temperature", f"{drive} (positive heats)"]
    dashed = [label.split(" / ")[0] for _, _, asked, label, _ in panels if np.any(np.isfinite(asked))]
    text = ", ".join(names)
    text += f"; dashed: the wanted {' and '.join(reversed(dashed))}" if dashed else ""
    return page.saved(fig, out, "courses", f"{text}.".capitalize())


def _facts(run: RunRows) -> str:
    """Return the line under a report's headline: when, on what rig, with which instruments, and how it ended."""
    start, stop = run.document["start"], run.document.get("stop", {})
    timing = _punctuality(stop.get("ticks", {}))
    instruments = ", ".join(f"{one['maker']} {one['model']}" for one in start["instruments"].values())
    off = "output off, confirmed" if stop.get("output_off_confirmed") else "OUTPUT NOT CONFIRMED OFF"
    ended = f"Ended: {stop.get('reason', '?')}, {off}." if stop else "How it ended was not recorded."
    simulated = str(start["settings"]["bench"]["controller"]["port"]).startswith("sim://")
    where = "SIMULATED rig" if simulated else "real rig"
    text = f"{start['at'][:16].replace('T', ' ')} UTC, {where}: {instruments}. {ended}"
    more = [page.paragraph(line, "note") for line in (f"Folder: {run.path.name}.", timing) if line]
    return page.paragraph(text, "note") + page.details("Folder and timing of the control loop", *more)


def _titled(run: RunRows, text: str) -> str:
    """Return the title of a page: the experiment's name, and what it was."""
    name = run.document["start"]["settings"].get("experiment", {}).get("name", "")
    return f"{name}: {text}" if name else f"{text[:1].upper()}{text[1:]}"


def _punctuality(ticks: Mapping[str, float]) -> str:
    """Return how punctual a run was: ticks done and missed, longest time without a reading with a current on."""
    if not ticks:
        return ""
    text = f"{ticks['done']} control periods, {ticks['missed']} missed; a period began at most "
    text += f"{1e3 * ticks['latest_s']:.0f} ms after its time (real or simulated)"
    if "unwatched_s" in ticks:
        gaps = f", {ticks['gaps']} gap{'s' * (ticks['gaps'] > 1)}" if ticks["gaps"] else ""
        unwatched = f"{ticks['unwatched_s']:.2f} s{gaps}"
        text += f"; the longest time that a current flowed without a temperature reading: {unwatched}"
    if count := ticks.get("unacknowledged"):
        text += f"; {count} command{'s' * (count > 1)} not acknowledged"
    return text + "."


def _write_profile_page(run: RunRows, out: Path) -> None:
    seconds = float(run.column("time_s")[-1])
    numbers = [(str(run.rows), "rows"), (f"{seconds:.0f} s", "duration")]
    lead = f"{run.rows} rows over {seconds:.0f} s were recorded."
    parts = [page.section("Courses", _courses(run, out))]
    if (error := target_error(run)) is not None:
        judged = in_brackets(judgement(error.rms, error.unit, OF_TARGET))
        numbers += [(error.shown_rms, f"RMS error {COUNTED}{judged}"), (error.shown_largest, "largest error")]
        lead = f"The temperature was within {error.shown_rms} RMS of the wanted one {COUNTED}. {lead}"
        parts.append(page.section("The error", _error_figure(out, {"temperature": run})))
    kind = str(run.document["start"]["what"])
    title = TITLES.get(kind, kind.replace("_", " ")).format(drive=drive_label(run)[0])
    page.write_page(out / "report.html", _titled(run, title), lead, [_facts(run), page.tiles(numbers), *parts])


def _write_tracking_page(run: RunRows, out: Path, inner: Mapping[str, RunRows]) -> None:
    """Write report.html of one law's run into `out`; inner: its calibration and the laws to compare with, by name."""
    own, what = _law_of(run), tracked(run)
    runs = {own: run, **{name: other for name, other in inner.items() if name != CALIBRATION}}
    found = {name: score(one, name, limit_A(one)) for name, one in runs.items()}
    scores = {name: one for name, one in found.items() if one is not None}
    mine, design = scores[own], run.document["result"]["design"]
    calibration = inner[CALIBRATION].document.get("result") if CALIBRATION in inner else None
    doubts = calibration.get("identifiability", [])[:2] if calibration is not None else []
    parts = [
        _facts(run),
        page.tiles(_numbers(run, mine, calibration)),
        page.section(f"Wanted and measured {what.name}", _courses(run, out, TRACK)),
        page.section("The error", _error_figure(out, {name: runs[name] for name in scores})),
        page.section("The loop", _loop(run, what, out, own)),
    ]
    if len(scores) > 1:
        parts.append(page.section("The laws on the same target", _laws(runs, scores, own)))
    if doubts:
        parts.append(page.section("Warnings of the calibration", page.bullets(doubts)))
    parts += _further(out, inner)
    parts.append(page.section("What the numbers mean", *_meanings(run, own, design)))
    lead = (
        f"The law '{own}' kept the film within {_error(mine.rms, mine, 4)}"
        f"{in_brackets(percent(mine.rms) if mine.unit == 'dec' else '')} RMS of the wanted {what.name} "
        f"(95 % of it within {_error(mine.p95, mine, 3)}; at worst {_error(mine.max, mine, 3)}, "
        f"at {mine.max_at_s:.1f} s)."
    )
    others = {name: one.rms / mine.rms for name, one in scores.items() if name != own}
    if others:
        lead += " " + " and ".join(f"{times:.1f} times better than '{name}'" for name, times in others.items()) + "."
    page.write_page(out / "report.html", _titled(run, f"tracking a wanted {what.name}, law {own}"), lead, parts)


def _error(error: float, of: Score, digits: int) -> str:
    return shown_error(error, of.unit, digits).replace(" dec", " decades")


def _law_of(run: RunRows) -> str:
    return str(run.document["start"]["what"]).removeprefix(LAW)


def _further(out: Path, inner: Mapping[str, RunRows]) -> list[str]:
    """Return a section with links to the reports of the runs inside this one's folder."""
    if not inner:
        return []
    texts = [name if name.startswith(CALIBRATION) else f"{LAW}{name}" for name in inner]
    addresses = [Path(os.path.relpath(one.part / "report.html", out)).as_posix() for one in inner.values()]
    return [page.section("Further reports", page.links(zip(texts, addresses, strict=True)))]


def _numbers(run: RunRows, mine: Score, calibration: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    in_percent = f" = {percent(mine.rms)}" if mine.unit == "dec" else ""
    judged = in_brackets(judgement(mine.rms, mine.unit, OF_TARGET))
    numbers = [
        (f"{shown_error(mine.rms, mine.unit, 4)}{in_percent}", f"RMS error {COUNTED}{judged}"),
        (shown_error(mine.max, mine.unit, 3), f"largest error, at {mine.max_at_s:.1f} s"),
    ]
    if math.isfinite(mine.current_at_limit):
        share = 100 * mine.current_at_limit
        numbers.append((f"{share:.0f} %", f"of the time the {drive_label(run)[0]} was at its limit"))
    if calibration is not None:
        error = calibration["check_rmse_dec"]
        judged = in_brackets(judgement(error, "dec", OF_MODEL))
        numbers.append((f"{error:.4f} dec", f"RMS error of the calibration's film model on held-out rows{judged}"))
    return numbers


def _loop(run: RunRows, what: Tracked, out: Path, own: str) -> str:
    fig, (axes,) = page.new_figure(1, 4.6)
    tracking, columns = run.column("phase") == TRACK, ("time_s", "temperature_degC", what.measured)
    parts = [
        (~tracking, page.EDGE, "conditioning and approach"),
        (tracking, page.COLOURS.get(own, page.COLOURS["measured"]), "tracking"),
    ]
    for rows, colour, name in parts:
        time, degC, shown = (run.column(each)[rows] for each in columns)
        page.draw_line(axes, time, shown, over=degC, color=colour, linewidth=1.1, label=name)
    unit = "ohm" if what.in_ohm else what.unit
    axes.set(xlabel="temperature / \N{DEGREE SIGN}C", ylabel=f"{what.name} / {unit}")
    if what.in_ohm:
        page.log_scale(axes)
    axes.legend(loc="best")
    text = (
        f"{what.name.capitalize()} over temperature, as measured: each turning point of the target begins a minor loop."
    )
    text += " The heating branch is the one at higher temperature." * what.in_ohm
    return page.saved(fig, out, "loop", text)


def _laws(runs: Mapping[str, RunRows], scores: Mapping[str, Score], own: str) -> str:
    unit = scores[own].unit
    names = {
        "full": "full: model of film and plate, with feedback",
        "pid": f"pid: feedback on {'log R' if unit == 'dec' else 'the output'} alone, no model",
        "feedforward": "feedforward: the same model, no feedback",
        "instrument_pid": "instrument_pid: the model's temperature, by the controller's own PID",
    }
    rows = [
        [
            names.get(law, law),
            shown_error(one.rms, unit, 4).split()[0],
            shown_error(one.p95, unit, 4).split()[0],
            shown_error(one.max, unit, 3).split()[0],
            f"{one.rms / scores[own].rms:.1f}",
        ]
        for law, one in scores.items()
    ]
    head = ["law", f"RMS / {unit}", f"95 % within / {unit}", f"largest / {unit}", f"RMS / RMS of {own}"]
    return page.table(head, rows, best=0)


def _meanings(run: RunRows, own: str, design: Mapping[str, Any]) -> list[str]:
    in_ohm = tracked(run).in_ohm
    what = f"measured - wanted {'log10 R' if in_ohm else tracked(run).name}"
    texts = [
        f"Errors are {what}, from the first row of the target to its last. Conditioning, the approach to the first "
        "value and the time to settle on it are not counted. All laws began at the same temperature on the same "
        "branch of the loop.",
    ]
    if in_ohm:
        texts.append("0.01 decades (dec) are 2.3 % of the resistance, 0.05 are 12 %.")
    if own in ("feedforward", "instrument_pid"):
        loops = {"feedforward": "No loop is closed", "instrument_pid": "The loop is closed by the controller's own PID"}
        texts.append(f"{loops[own]} under this law.")
        return [page.paragraph(text, "note") for text in texts]
    margins, unit = design["margins"], drive_label(run)[1].replace("of full", "full")
    loop = "temperature" if own != "pid" else "log R" if in_ohm else "output"
    values = [
        (f"{margins['ms']:.2f}", "maximum sensitivity Ms: by how much the loop amplifies a disturbance at worst"),
        (f"{margins['phase_margin_deg']:.0f}\N{DEGREE SIGN}", "phase margin"),
        (f"{20 * math.log10(float(margins['gain_margin'])):.1f} dB", "gain margin"),
    ]
    if own != "pid":
        values.append((f"{design['dead_time_s']:g} s", "dead time"))
        values.append((f"{design['period_s']:g} s", "control period"))
    elif in_ohm:
        values.append((f"{design['process_gain']:.3g}", f"decades per {unit} and second, the film's steepest slope"))
    control = page.details(f"Stability of the {loop} control loop", page.table(["value", "of"], values))
    return [*(page.paragraph(text, "note") for text in texts), control]


def _write_ended_page(run: RunRows, out: Path, inner: Mapping[str, RunRows]) -> None:
    """Write report.html of a run that ended early into `out`; inner: the runs inside its folder, by name."""
    stop, what = run.document.get("stop", {}), str(run.document["start"]["what"])
    reason = str(stop.get("reason", "unknown")).replace("_", " ")
    reason = "all recorded, and nothing fitted" if reason == "done" else reason
    time, phase = run.column("time_s"), str(run.column(PHASE)[-1])
    lead = f"This run ended early, after {float(time[-1]):.1f} s, in its phase '{phase}': {stop.get('text') or reason}."
    numbers = [(reason, "why it ended"), (f"{float(time[-1]):.1f} s", "duration"), (str(run.rows), "rows")]
    if (error := target_error(run)) is not None:
        numbers += [(error.shown_rms, "RMS error until then"), (error.shown_largest, "the largest")]
    parts = [_facts(run), page.tiles(numbers), page.section("What was recorded", _courses(run, out))]
    if error is not None:
        note = f"Errors {COUNTED} that was recorded."
        parts.append(page.section("The error", _error_figure(out, {_law_of(run): run}), page.paragraph(note, "note")))
    events = _events(run.part / "events.jsonl")
    if events:
        parts.append(page.section("What happened last", page.table(["time / s", "what", "more"], events, kind="words")))
    title = what.removeprefix(LAW) if not what.startswith(LAW) else f"tracking a wanted {tracked(run).name}"
    page.write_page(out / "report.html", _titled(run, f"{title}, ended early"), lead, [*parts, *_further(out, inner)])


def _events(path: Path) -> list[list[str]]:
    """Return the last events; a line that was cut off is left out."""
    rows: list[list[str]] = []
    with suppress(OSError):
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            with suppress(ValueError, KeyError, TypeError):
                event: Any = json.loads(line)
                kind, text = str(event["event"]).replace("_", " "), str(event["text"])
                short = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
                rows.append([f"{float(event['time_s']):.2f}", kind, short])
    return rows[-LAST_EVENTS:]


def _write_calibration_page(run: RunRows, out: Path) -> None:
    result = run.document["result"]
    lead = (
        f"The film model predicts log R to {result['check_rmse_dec']:.4f} decades RMS "
        f"(largest {result['check_max_dec']:.3f}) on {result['rows_checked']} rows that it was not fitted to."
    )
    low, high = result["transition_degC"]
    film_error, plate_error = result["check_rmse_dec"], result["check_rmse_K"]
    of_film = f"film model: RMS error of log R on held-out rows{in_brackets(judgement(film_error, 'dec', OF_MODEL))}"
    of_plate = f"plate model: RMS error of the temperature from the {drive_label(run)[0]} on held-out rows"
    numbers = [
        (f"{film_error:.4f} dec = {percent(film_error)}", of_film),
        (f"{result['rmse_dec']:.4f} dec", "film model: RMS error on fitted rows"),
        (f"{plate_error:.3g} K", of_plate + in_brackets(judgement(plate_error, "K", OF_MODEL))),
        (f"{low:.0f} to {high:.0f} \N{DEGREE SIGN}C", "where heating and cooling branch differ"),
    ]
    form = [(result["memoryless"], "form of D(T), the part of log R without hysteresis")]
    form.append((str(result["operators"]), "play operators of the film model"))
    plate = [
        (one["name"], one["value"], None if (error := one["standard_error"]) is None else NORMAL_95 * error)
        for one in result["plate"]
    ]
    doubts = result["identifiability"]
    predicted = _predicted(run.part / PREDICTED, run.rows)
    film = [_loops(run, out, predicted)]
    if predicted is not None:
        film.append(_residual(run, out, predicted))
    unknown = page.bullets(doubts) if doubts else page.paragraph("Nothing: it determines film and plate.")
    film.append(page.details("The film model's form", page.table(["value", "of"], form)))
    parts = [_facts(run), page.tiles(numbers), page.section("The film", *film)]
    if result.get("transition"):
        parts.append(transition_section(out, result["transition"]))
    parts.append(page.section(NOT_DETERMINED, unknown))
    parts.append(page.section("The plate", plate_table(plate), _courses(run, out)))
    page.write_page(out / "report.html", _titled(run, "calibration of film and plate"), lead, parts)


def _predicted(path: Path, rows: int) -> Array | None:
    """Return the model's resistance (ohm) row by row; None if the folder, of an earlier version, has none."""
    if not path.is_file():
        return None
    found = read_record(path, options=False).columns.get("predicted_ohm")
    return found if found is not None and found.size == rows else None


def _loops(run: RunRows, out: Path, predicted: Array | None) -> str:
    fig, (axes,) = page.new_figure(1, 4.8)
    time, degC, ohm = (run.column(name) for name in ("time_s", "temperature_degC", "resistance_ohm"))
    checked = run.column(PHASE) == "check"
    drawn: list[tuple[Any, Any, str, str, Any]] = [
        (~checked, ohm, page.EDGE, "fitted rows", "-"),
        (checked, ohm, page.BLUE, "held-out rows", "-"),
    ]
    if predicted is not None:
        drawn.append((checked, predicted, page.COLOURS["model"], "model", (0, (2, 2))))
    for rows, values, colour, name, style in drawn:
        page.draw_line(axes, time[rows], values[rows], over=degC[rows], color=colour, linestyle=style, label=name)
    axes.set(xlabel="temperature / \N{DEGREE SIGN}C", ylabel="resistance / ohm")
    page.log_scale(axes)
    axes.legend(loc="upper right")
    text = "Major and minor loops. The model's prediction hides the held-out rows where it is right."
    return page.saved(fig, out, "loops", text)


def _residual(run: RunRows, out: Path, predicted: Array) -> str:
    fig, (axes,) = page.new_figure(1, 2.4)
    time = run.column("time_s")
    draw_residual(axes, time, residual_dec(run.column("resistance_ohm"), predicted))
    checked = time[run.column(PHASE) == "check"]
    axes.axvspan(float(checked[0]), float(checked[-1]), color=page.SHADE, zorder=0)
    axes.set(xlabel="time / s", ylabel=residual_label("dec"))
    return page.saved(fig, out, "residual", "The residual of log10 R over time; shaded: held-out rows.")
