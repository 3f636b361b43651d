"""A run folder and a loop on the bench, and what is written down when the run ends, whatever ends it.

Order on every way out: output off and confirmed, rows flushed, reason and trip written, files closed, report. A disk
that is full, or gone, stops none of this: what cannot be written is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rig.bench.assembly import Bench, OutputOff
from rig.config.configuration import ConfigurationFile
from rig.control.decision import Onlooker
from rig.control.loop import Loop
from rig.core.faults import Faults
from rig.core.outcome import NotConfirmedOff, Stopped, Tripped
from rig.core.reading import OF_A_RUN
from rig.drivers.controller import drive_unit
from rig.drivers.meter import LOG_RESISTANCE
from rig.guard.pipe import add_guard_death
from rig.records.run_folder import RunFolder, plain_json
from rig.safety.bench_watch import Limits
from rig.safety.signals import SignalStop
from rig.safety.switching_off import UNTRUSTED_THERMOMETER, check_temperature, off_confirmed

REASONS: dict[type, str] = {Stopped: "signal", Faults: "bad_input", NotConfirmedOff: "not_confirmed_off"}
FEWEST_ROWS = 2  # for a report
TRIP_S = 60.0  # of rows before a trip, kept with its cause
Report = Callable[[RunFolder], None]  # writes a run's report into its folder


def no_report(folder: RunFolder) -> None:
    """Write no report."""


def limits_of(file: ConfigurationFile) -> Limits:
    """Return the interlock's limits from the configuration."""
    table = file.content.limits
    low, high = table.temperature_degC
    return Limits(low, high, table.current_A, table.meter_current_A, table.stale_s, table.rate_K_per_s, table.runaway_s)


@dataclass(frozen=True)
class Session:
    """A bench that is open, the configuration it was opened for, and how to talk to the user meanwhile. report: writes
    a run's report."""

    bench: Bench
    file: ConfigurationFile
    signals: SignalStop
    say: Callable[[str], None]
    onlooker: Onlooker = field(default_factory=Onlooker)
    report: Report = no_report


@contextmanager
def one_run(session: Session, path: Path, what: str) -> Iterator[tuple[Loop, RunFolder]]:
    """Open a run folder and a loop on the session's bench; at the end the output is off, and the reason is written
    down."""
    bench, file, signals, onlooker = session.bench, session.file, session.signals, session.onlooker
    start: dict[str, Any] = {
        "what": what,
        "configuration": str(file.path),
        "settings": file.content.model_dump(mode="json"),
        "instruments": {name: asdict(identity) for name, identity in bench.identities.items()},
        "dead_man": bench.controller.has_dead_man,
        "drive_unit": drive_unit(bench.controller),
        "guarded": bench.guard.guarding,
    }
    folder = RunFolder(path, start, file.text, _columns_of(bench))
    try:
        onlooker.began()
    except BaseException:  # a job that was ended without its thread
        folder.abandon()
        raise
    bench.guard.records(str(folder.part.absolute()))
    meter = file.content.bench.meter
    loop = Loop(bench, limits_of(file), folder, signals, onlooker, meter.average if meter else None)
    output = OutputOff(bench.controller, file.content.bench.controller, bench.guard, signals)
    try:
        with output:
            yield loop, folder
        _look_after_off(bench, loop, output)
        loop.leave_meter()
        onlooker.ended(bool(output.confirmed), loop.ticks)
        folder.stop("done", **_ending(loop, output))
    except BaseException as error:
        if isinstance(error, Tripped):
            loop.tripped = error
        if isinstance(error, Stopped):
            add_guard_death(bench.guard, error)
        ended_s = loop.elapsed_s()
        try:
            if not isinstance(error, NotConfirmedOff):
                _look_after_off(bench, loop, output, error, session.say)
        except NotConfirmedOff as withdrawn:
            error = withdrawn
        for step in (
            folder.flush,
            partial(_write_reason, onlooker, folder, loop, output, error, ended_s),
            folder.abandon,
        ):
            try:
                step()
            except (OSError, ValueError) as problem:  # full, gone, or closed with rows that found no room
                _note(error, f"{folder.part} is not whole", problem)
        with suppress(Exception):  # how the run ended is more important
            loop.leave_meter()
        if not bench.watched_after:
            _write_report(folder, error, session.report)
        raise error


@contextmanager
def worked_out(folder: RunFolder) -> Iterator[None]:
    """Close the files and say where they are, whatever ends the work on rows after their run: a fit, a report."""
    try:
        yield
    except BaseException as error:
        with suppress(OSError):  # what ended it is more important
            folder.abandon()
        error.add_note(f"what was recorded is in {folder.part}")
        raise


def _columns_of(bench: Bench) -> list[str]:
    """Return a row's columns: those of every run, and if the meter's voltage stands for a quantity, this: wanted, by
    the model, and read."""
    output = bench.meter.output if bench.meter is not None else LOG_RESISTANCE
    return [*OF_A_RUN] if output == LOG_RESISTANCE else [*OF_A_RUN, f"target_{output}", f"predicted_{output}", output]


def _look_after_off(
    bench: Bench,
    loop: Loop,
    output: OutputOff,
    error: BaseException | None = None,
    say: Callable[[str], None] | None = None,
) -> None:
    """Withdraw a confirmation that the temperature contradicts. Raises NotConfirmedOff.

    If somebody goes on reading after this run, that is for them.
    """
    if not output.confirmed or bench.watched_after or getattr(error, "cause", "") in UNTRUSTED_THERMOMETER:
        return
    curves, controller, clock = loop.after_off(), bench.controller, bench.clock
    if curves is None:
        return
    if say is not None and error is not None:
        watched = f"for up to {curves.lasts_s:.0f} s the temperature is watched, whether it agrees"
        with suppress(OSError):  # nobody reads any more: the rows are still to be written
            say(f"{off_confirmed(controller)}; {watched}")
    dead_man_s = float(getattr(controller, "dead_man_s", 0.0)) if controller.has_dead_man else 0.0
    look = check_temperature(curves, controller, clock, clock.now_s(), dead_man_s)
    if look.agrees is False:
        output.confirmed = False
        bench.guard.given_up()
        raise NotConfirmedOff(look.text) from error


def _note(error: BaseException, what: str, problem: Exception) -> None:
    """Add a note on a problem, with its cause if that is not said yet: a full disk has one reason for every file."""
    said = [str(error), *getattr(error, "__notes__", [])]
    known = (getattr(problem, "strerror", None) or str(problem)) in "; ".join(said)
    if not (known and any(note.startswith(what) for note in said)):
        error.add_note(what if known else f"{what}: {problem}")


def _write_report(folder: RunFolder, error: BaseException, report: Report) -> None:
    """Write the report of a run that ended early. If the output is not confirmed off nobody waits for one: that is said
    first, and the guard, or `peltier report`, writes it later. A daemon writes it once a trip is latched."""
    if report is no_report or len(folder.rows) < FEWEST_ROWS:
        return
    if isinstance(error, NotConfirmedOff):
        error.add_note(f"what was recorded is in {folder.part}, and `peltier report` draws it")
        return
    try:
        report(folder)
    except Exception as problem:  # whatever it is, how the run ended is more important
        _note(error, "no report could be written", problem)
    else:
        error.add_note(f"report: {folder.part / 'report.html'}")


def _ending(loop: Loop, output: OutputOff) -> dict[str, Any]:
    return {
        "output_off_confirmed": output.confirmed,
        "ticks": loop.ticks.__dict__,
        "readings_rejected": loop.rejected,
    }


def _write_reason(
    onlooker: Onlooker, folder: RunFolder, loop: Loop, output: OutputOff, error: BaseException, ended_s: float
) -> None:
    """Write why the run ended. ended_s: when the output was off, of the run's time."""
    reason = getattr(error, "cause", None) or REASONS.get(type(error), type(error).__name__)
    folder.event(ended_s, "stop", str(error), cause=reason)
    if loop.tripped is not None:
        folder.keep("trip.json", trip_text(loop, loop.tripped))
    onlooker.ended(bool(output.confirmed), loop.ticks)
    folder.stop(reason, text=str(error), **_ending(loop, output))


def trip_text(loop: Loop, trip: Tripped) -> str:
    """Return a trip as JSON: cause, text, time of the run (s), limits, and the rows of the last `TRIP_S` seconds."""
    rows = loop.folder.rows
    time_s = rows.numbers(0)
    last: list[int] = np.flatnonzero(time_s >= time_s[-1:] - TRIP_S).tolist()  # none of none
    return plain_json(
        {
            "format": "peltier-trip/1",
            "cause": trip.cause,
            "text": str(trip),
            "time_s": loop.elapsed_s(),
            "controller": loop.status_at_trip,
            "limits": asdict(loop.limits),
            "columns": loop.folder.columns,
            "rows": [rows[k] for k in last],
        }
    )
