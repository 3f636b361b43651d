"""The report of a run that did not come to its end: why, when, in which phase, and what was recorded until then."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rig.analysis.score import COUNTED, largest, profile_error, rms, shown_error, tracked, tracking_error
from rig.report.page import facts, paragraph, section, table, tiles, write_page
from rig.report.profile import kelvin
from rig.report.run_figures import courses, kelvin_figure, tracking_figure
from rig.report.run_rows import LAW, PHASE, RunRows
from rig.report.tracking import further, law_of

LAST_EVENTS = 12  # what led to the end, on half a screen
LONGEST = 160  # characters of an event


def write_ended_report(run: RunRows, out: Path, inner: Mapping[str, RunRows]) -> None:
    """report.html of a run that ended early, in `out`; inner: the runs inside its folder, by name."""
    stop, what = run.document.get("stop", {}), str(run.document["start"]["what"])
    reason = str(stop.get("reason", "unknown")).replace("_", " ")
    reason = "all recorded, and nothing fitted" if reason == "done" else reason
    time, phase = run.column("time_s"), str(run.column(PHASE)[-1])
    lead = f"This run ended early, after {float(time[-1]):.1f} s, in its phase '{phase}': {stop.get('text') or reason}."
    numbers = [(reason, "why it ended"), (f"{float(time[-1]):.1f} s", "duration"), (str(run.rows), "rows")]
    errors, figures = _errors(run, out)
    parts = [facts(run), tiles([*numbers, *errors]), section("What was recorded", courses(run, out))]
    if figures:
        note = f"Errors {COUNTED} that was recorded."
        parts.append(section("The error", *figures, paragraph(note, "note")))
    events = _events(run.part / "events.jsonl")
    if events:
        parts.append(section("What happened last", table(["time / s", "what", "more"], events, kind="words")))
    title = what.removeprefix(LAW) if not what.startswith(LAW) else f"tracking a wanted {tracked(run).name}"
    write_page(out / "report.html", f"{run.path.name}: {title}, ended early", lead, [*parts, *further(out, inner)])


def _errors(run: RunRows, out: Path) -> tuple[list[tuple[str, str]], list[str]]:
    """Numbers and figures of the error, as far as a target was followed."""
    _, off = tracking_error(run)
    unit = tracked(run).unit
    _, kelvins = profile_error(run)
    if np.any(np.isfinite(off)):
        whole, most = shown_error(rms(off), unit, 4), shown_error(largest(off), unit, 3)
        return [(whole, "RMS error until then"), (most, "the largest")], [tracking_figure(out, {law_of(run): run})]
    if np.any(np.isfinite(kelvins)):
        numbers = [(kelvin(rms(kelvins)), "RMS error until then"), (kelvin(largest(kelvins)), "the largest")]
        return numbers, [kelvin_figure(out, run)]
    return [], []


def _events(path: Path) -> list[list[str]]:
    """The last of what happened; a line that was cut off is left out."""
    rows: list[list[str]] = []
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    for line in lines:
        try:
            event: Any = json.loads(line)
            kind, text = str(event["event"]).replace("_", " "), str(event["text"])
            short = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
            rows.append([f"{float(event['time_s']):.2f}", kind, short])
        except (ValueError, KeyError, TypeError):
            continue
    return rows[-LAST_EVENTS:]
