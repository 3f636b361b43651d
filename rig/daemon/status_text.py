"""Text for people from a bench's state, for `status`, `watch` and the log. Import-light."""

from __future__ import annotations

import math
import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any

FRESH_S = 5.0  # an older reading is marked as old; so do the page and the overview


def number(value: float | None, unit: str, digits: int) -> str:
    """Return a value with its unit, or a dash."""
    if value is None or not math.isfinite(value):
        return f"- {unit}"
    return f"{value:.{digits}f} {unit}"


def resistance(value: float | None) -> str:
    """Return a resistance in ohm, kohm or Mohm."""
    if value is None or not math.isfinite(value):
        return "- ohm"
    for factor, unit in ((1e6, "Mohm"), (1e3, "kohm")):
        if abs(value) >= factor:
            return f"{value / factor:.4g} {unit}"
    return f"{value:.4g} ohm"


def span(seconds: float) -> str:
    """Return a duration in s, min, h or days."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    if seconds < 7200.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h" if seconds < 172800.0 else f"{seconds / 86400.0:.1f} days"


def clock(seconds: float) -> str:
    """Return minutes and seconds, with hours if there are any: 4:05, 1:02:30."""
    whole = max(0, round(seconds))
    hours, rest = divmod(whole, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"


def progress_line(row: dict[str, Any], job: dict[str, Any], state_s: float) -> str:
    """Return a job's progress and readings at a row; state_s: time of the job's state, Unix s."""
    since_s = max(row["time_s"] - state_s, 0.0)
    degC, drive = number(row.get("temperature_degC"), "degC", 2), shown_drive(row.get("current_A"), job["drive_unit"])
    readings = degC, resistance(row.get("resistance_ohm")), drive
    return phase_line(job["phase"], job["elapsed_s"] + since_s, max(job["to_go_s"] - since_s, 0.0), readings)


def phase_line(phase: str, elapsed_s: float, to_go_s: float, readings: Iterable[str], about: str = "about") -> str:
    """Return a line with an experiment's phase, how long it has lasted and will last, and its readings."""
    total = f"{clock(elapsed_s)} of {about} {clock(elapsed_s + to_go_s)}, {clock(to_go_s)} to go"
    return "   ".join([f"{phase:<9} {total}", *readings])


def shown_drive(value: float | None, unit: str) -> str:
    """Return a current, or a share of full drive."""
    return number(value, unit, 2 if unit == "A" else 3)


def status_rows(state: dict[str, Any]) -> list[tuple[str, str]]:
    """Return (name, text) for the lines of `peltier status`."""
    reading, job, ticks = state["reading"], state["job"], state["ticks"]
    confirmed = off_in_words(state) if state["output_confirmed"] else "NOT CONFIRMED: switch the controller off by hand"
    found = [
        ("state", str(state["state"])),
        ("output", f"{state['output']}, {confirmed}"),
    ]
    for key in ("trip", "stop"):
        if state.get(key):
            found.append((key, f"{state[key]['text']} ({span(state['time_s'] - state[key]['at_s'])} ago)"))
    if job is not None:
        done = f", {span(job['done_s'])} of {span(job['total_s'])}" if job["total_s"] else ""
        if job["to_go_s"] > 0.0:
            done += f"; in all about {span(job['to_go_s'])} to go"
        found.append(("job", f"{job['name']} ({job['kind']}): {job['phase']}{done}"))
    elif state.get("last_job"):
        last = state["last_job"]
        found.append(("last job", job_in_words(last)))
        if last.get("report"):
            found.append(("report", f"{last['folder']}/report.html"))
    wanted, unit = number(reading.get("setpoint_degC"), "degC", 3), state.get("drive_unit", "A")
    unread = f"at most {number(ticks.get('unwatched_s'), 's', 2)} without a reading while a current was on"
    found += [
        ("queue", f"{state['queue']} waiting" + ("; none starts" if state["no_job_because"] else "")),
        ("temperature", f"{number(reading.get('temperature_degC'), 'degC', 3)}, wanted {wanted}"),
        ("drive" if unit != "A" else "current", number(reading.get("current_A"), unit, 3)),
        ("resistance", f"{resistance(reading.get('resistance_ohm'))}, wanted {resistance(reading.get('target_ohm'))}"),
        ("reading", stale(state) or f"{reading.get('quality')}, {_age(state)}"),
        ("film's memory", "known" if state["memory_known"] else "not known until the film was conditioned"),
        ("ticks", f"{ticks['done']} done, {ticks['missed']} missed, at most {1e3 * ticks['latest_s']:.1f} ms late"),
        ("watch", unread),
        ("gaps", _gaps(state["gaps"])),
        ("dead man", number(state["dead_man_s"], "s", 1) if state["dead_man_s"] else "none: the controller has none"),
        *[(role, text) for role, text in state["instruments"].items()],
        ("up", span(state["uptime_s"])),
        *[("warning", text) for text in state["warnings"]],
    ]
    return found


def off_in_words(state: dict[str, Any]) -> str:
    """Return the text for a confirmed "off", with its evidence."""
    rests_on = f" ({state['output_confirmed_by']})" if state.get("output_confirmed_by") else ""
    return f"confirmed by the controller{rests_on}"


def job_in_words(job: dict[str, Any]) -> str:
    """Return a line about a job and its end."""
    text = f"job {job['id']} {job['name']} ({job['kind']}): {job['state']}"
    if job["started_s"] is not None and job["ended_s"] is not None:
        text += f" after {span(job['ended_s'] - job['started_s'])}"
    if job["reason"]:
        text += f": {job['reason']}"
    return f"{text}; {job['folder']}" if job["folder"] else text


def _gaps(gaps: dict[str, Any]) -> str:
    if not gaps["count"]:
        return "none in its readings"
    return f"{gaps['count']} in its readings, the longest {span(gaps['longest_s'])}, {span(gaps['total_s'])} in all"


def stale(state: dict[str, Any]) -> str:
    """Return a text if the readings shown are old, else ""."""
    taken = state["reading"].get("time_s")
    if taken is None or (state["state"] != "offline" and state["time_s"] - taken <= FRESH_S):
        return ""
    return f"NONE for {span(max(0.0, state['time_s'] - taken))}: the values shown are older"


def watch_line(state: dict[str, Any]) -> str:
    """Return a line with time of day, readings and urgent remarks, for `peltier watch` without a terminal."""
    reading, phase = state["reading"], state["job"]["phase"] if state["job"] else "-"
    clock_time = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(state["time_s"]))
    values = (
        number(reading.get("temperature_degC"), "degC", 3),
        number(reading.get("current_A"), state.get("drive_unit", "A"), 3),
        resistance(reading.get("resistance_ohm")),
    )
    old = f"reading: {text}" if (text := stale(state)) else ""
    unknown = "" if state["output_confirmed"] else "OUTPUT NOT CONFIRMED"
    return "  ".join(part for part in (f"{clock_time} {state['state']:<8} {phase:<10}", *values, old, unknown) if part)


def _age(state: dict[str, Any]) -> str:
    taken = state["reading"].get("time_s")
    return "never" if taken is None else f"{span(max(0.0, state['time_s'] - taken))} ago"
