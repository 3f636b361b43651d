"""The bench as people see it: its state in words and numbers, what keeps a job from starting, what they should know."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rig.daemon.latch import STOPPED
from rig.version import __version__

if TYPE_CHECKING:
    from rig.daemon.desk import Desk


def bench_state(desk: Desk) -> dict[str, Any]:
    """The bench at this moment (docs/bench_api.md)."""
    limits, latch, job = desk.file.content.limits, desk.latching.told, desk.queue.running
    phase = desk.phase
    word = latch.state if latch is not None else "running" if job is not None else "idle"
    if not desk.online:
        word = "offline" if word in ("idle", "running") else word
    waits = desk.writer.trouble is not None and desk.writer.stands_in_the_way() is not None
    row = desk.live if waits or not desk.recent else desk.recent[-1]
    shown = ("time_s", "temperature_degC", "setpoint_degC", "current_A", "resistance_ohm", "target_ohm", "quality")
    reading = {name: row.get(name) for name in shown}
    if waits:
        reading["quality"] = "not recorded" if desk.writer.failure is not None else "not recorded yet"
    now_s, label_s = desk.clock.now_s(), desk.label_s()
    doing: dict[str, Any] | None = None
    if job is not None:
        name, began_s, total_s = phase if phase is not None else ("working", now_s, 0.0)
        doing = {"id": job.id, "name": job.name, "kind": job.kind, "phase": name}
        done_s = min(now_s - began_s, total_s)
        doing |= {"done_s": done_s, "total_s": total_s}
        doing |= {"elapsed_s": now_s - desk.job_began_s, "to_go_s": total_s - done_s + desk.coming_s}
    return {
        "time_s": label_s,
        "version": __version__,
        "name": desk.file.content.serve.name,
        "uptime_s": max(0.0, desk.steady_s() - desk.began_s),
        "state": word,
        "output": desk.output,
        "output_confirmed": desk.confirmed,
        "output_confirmed_by": desk.confirms_off_by if desk.output == "off" else None,
        "trip": latch.table() if latch is not None and latch.state != STOPPED else None,
        "stop": latch.table() if latch is not None and latch.state == STOPPED else None,
        "job": doing,
        "last_job": desk.queue.last_ended(),
        "queue": len(desk.queue),
        "no_job_because": no_job_because(desk),
        "reading": reading,
        "limits": {"temperature_degC": list(limits.temperature_degC), "current_A": limits.current_A},
        "drive_unit": desk.drive_unit,
        "dead_man_s": desk.file.content.bench.controller.dead_man_s if desk.has_dead_man else None,
        "instruments": {role: str(identity) for role, identity in desk.identities.items()},
        "ticks": {name: getattr(desk.ticks, name) for name in ("done", "missed", "latest_s", "unwatched_s")},
        "gaps": dict(desk.gaps.table()),
        "memory_known": desk.memory_since_s is not None,
        "viewers": 0,
        "stop_port": desk.stop_port,
        "warnings": warnings(desk),
        "cycle_age_s": now_s - desk.last_cycle_s,
    }


def no_job_because(desk: Desk) -> list[str]:
    """What keeps the next job from starting; nothing where it may."""
    held, told, trouble = desk.latching.held, desk.latching.told, desk.latching.trouble()
    found = []
    if told is not None:
        found.append(f"{told.state}: {told.text}")
    elif held is not None:
        found.append("a stop or a trip is being written down")
    if trouble is not None:
        found.append(f"the latch cannot be written: {trouble}")
    if desk.writer.failure is not None:
        found.append(f"the history cannot be written: {desk.writer.failure}")
    elif not desk.had_history and desk.writer.trouble is not None:
        found.append(f"the history cannot be read yet: {desk.writer.trouble.text}")
    if (not_off := desk.not_off) is not None:
        found.append(f"a job of before was left with its output not confirmed off: {not_off}")  # and is latched soon
    if not desk.confirmed:
        found.append("the output is not confirmed off")
    return found


def warnings(desk: Desk) -> list[str]:
    """What people should know."""
    found = list(desk.notes)
    if (trouble := desk.latching.trouble()) is not None:
        found.append(f"the latch cannot be written, no job starts: {trouble}")
    if not desk.online and desk.offline_because:
        found.append(f"offline: {desk.offline_because}")
    if (why := desk.writer.stands_in_the_way()) is not None:
        what = "has to wait" if desk.writer.failure is None else "cannot be written, no job starts"
        found.append(f"the history {what}: {why}")
    if desk.online and not desk.has_dead_man:
        found.append("the controller has no dead man of its own")
    return found
