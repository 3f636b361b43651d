"""EPICS records: readings, state, trip and job with the daemon's time stamps; STOP and, if allowed, commands.

A missing value is not-a-number. Alarms: a temperature beyond the bench's limits is MAJOR (HIHI, LOLO); a reading that
failed is INVALID (READ); one that is too old is INVALID (TIMEOUT); without the instruments, or without the daemon,
everything is INVALID (COMM). A missing setpoint is no alarm.

STOP can be written by everybody; with [epics] write also hold, run, cancel and reset exist. A command's record is busy
until the daemon has answered, so that a put that waits (`caput -c`, `wait=True`) has then been carried out; each has a
thread of its own, so that STOP waits for none of the others. A value beyond its limits is refused: the record keeps the
old one and has a MAJOR alarm (HWLIMIT) until a valid one is written.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from softioc import alarm, builder

from rig.config.tables import EpicsTable
from rig.daemon.client import Client, NoDaemon, Refusal
from rig.daemon.configurations import LONGEST_S, SHORTEST_S, USUAL_S

READ, STOP, WRITE = "DEFAULT", "STOP", "WRITE"  # access security: groups of records
STATES = (("idle",), ("running",), ("stopped", "MINOR"), ("tripped", "MAJOR"), ("offline", "INVALID"))
OUTPUTS = (("off",), ("on",), ("unknown", "MAJOR"))
PATIENCE_S = 5.0  # largest age of a reading, besides five of its periods
SHORT, LONG = 39, 1000  # bytes: a string record's, a text's
OWN_TIME = {"TSE": -2}  # the time stamp comes with the value
# record, key of a row, unit, digits
READINGS = (
    ("TEMPERATURE", "temperature_degC", "degC", 4),
    ("SETPOINT", "setpoint_degC", "degC", 4),
    ("CURRENT", "current_A", "A", 4),
    ("RESISTANCE", "resistance_ohm", "ohm", 3),
    ("TARGET", "target_ohm", "ohm", 3),
)
MEASURED = ("TEMPERATURE", "CURRENT", "RESISTANCE")
TEXTS = ("TRIP:TEXT", "STOPPED:TEXT", "WARNINGS", "JOB:NAME")
STRINGS = ("QUALITY", "TRIP:CAUSE", "JOB:ID", "JOB:PHASE")
COUNTS = ("QUEUE", "TICKS", "TICKS:MISSED")


def access_list(table: EpicsTable) -> str:
    """Return the access-security file (.acf).

    Everybody who reaches the server may read, and write STOP. The other records may be written by the users and hosts
    of a list. Only a record's value can be written, never a field of its configuration (ASL 0 in EPICS). A host is
    identified by the address of its packets; a user is the one that the client names.
    """
    lines, conditions = [], []
    for kind, group, names in (("UAG", "writers", table.users), ("HAG", "consoles", table.hosts)):
        if names:
            lines.append(f"{kind}({group}) {{ {', '.join(names)} }}")
            conditions.append(f"{kind}({group})")
    lines += [f"ASG({READ}) {{ RULE(1, READ) }}", f"ASG({STOP}) {{ RULE(1, READ) RULE(0, WRITE) }}"]
    if table.write:
        lines.append(f"ASG({WRITE}) {{ RULE(1, READ) RULE(0, WRITE) {{ {' '.join(conditions)} }} }}")
    return "\n".join(lines) + "\n"


class Published:
    """The readable records. limits_degC: the bench's, [low, high]; period_s: between readings while nothing runs."""

    def __init__(self, limits_degC: tuple[float, float], period_s: float) -> None:
        self.limits_degC = limits_degC
        self._patience_s = PATIENCE_S + 5.0 * period_s
        self._state: dict[str, Any] = {}
        low, high = limits_degC
        guarded = {"LOLO": low, "HIHI": high, "LLSV": "MAJOR", "HHSV": "MAJOR", "LOPR": low, "HOPR": high}
        self._records: dict[str, Any] = {}
        for name, _, unit, digits in READINGS:
            more = guarded if name == "TEMPERATURE" else {} if name in MEASURED else {"UDFS": "NO_ALARM"}
            self._add(name, builder.aIn, EGU=unit, PREC=digits, initial_value=math.nan, **more)
        self._add("STATE", lambda name, **more: builder.mbbIn(name, *STATES, **more))
        self._add("OUTPUT", lambda name, **more: builder.mbbIn(name, *OUTPUTS, **more))
        self._add("OUTPUT:CONFIRMED", builder.boolIn, ZNAM="no", ONAM="yes", ZSV="MAJOR")
        self._add("TRIP", builder.boolIn, ZNAM="none", ONAM="tripped", OSV="MAJOR")
        for name in ("JOB:DONE", "JOB:TOTAL"):
            self._add(name, builder.aIn, EGU="s", PREC=1)
        for name in STRINGS:
            self._add(name, builder.stringIn)
        for name in TEXTS:
            self._add(name, builder.longStringIn, length=LONG)
        for name in COUNTS:
            self._add(name, builder.longIn)
        self.lost()

    def _add(self, name: str, kind: Any, **fields: Any) -> None:
        self._records[name] = kind(name, **OWN_TIME, **fields)

    def take(self, event: str, data: dict[str, Any]) -> None:
        """Take an event of the daemon: a state, or a row."""
        if event == "state":
            self._take_state(data)
        elif event == "row":
            self._take_row(data)
            if (job := self._state.get("job")) is not None:
                done_s = job["done_s"] + max(data["time_s"] - self._state["time_s"], 0.0)
                self._set("JOB:DONE", min(done_s, job["total_s"]), data["time_s"])

    def lost(self) -> None:
        """Mark all records as invalid: the daemon does not answer."""
        self._state = {}
        for record in self._records.values():
            record.set_alarm(alarm.INVALID_ALARM, alarm.COMM_ALARM)

    def _take_row(self, row: dict[str, Any]) -> None:
        quality = str(row.get("quality"))
        for name, key, _, _ in READINGS:
            value = row.get(key)
            severity = (alarm.NO_ALARM, alarm.NO_ALARM)
            if name in MEASURED and value is None and (name != "RESISTANCE" or quality != "good"):
                severity = (alarm.INVALID_ALARM, alarm.READ_ALARM)
            self._set(name, math.nan if value is None else float(value), row["time_s"], *severity)
        doubt = (alarm.NO_ALARM, alarm.NO_ALARM) if quality == "good" else (alarm.MINOR_ALARM, alarm.STATE_ALARM)
        self._set("QUALITY", quality, row["time_s"], *doubt)

    def _take_state(self, state: dict[str, Any]) -> None:
        self._state, at_s = state, state["time_s"]
        trip, stop, job = state.get("trip"), state.get("stop"), state.get("job") or {}
        self._set("STATE", _number(STATES, state["state"]), at_s)
        self._set("OUTPUT", _number(OUTPUTS, state["output"]), at_s)
        self._set("OUTPUT:CONFIRMED", bool(state["output_confirmed"]), at_s)
        self._set("TRIP", trip is not None, trip["at_s"] if trip else at_s)
        self._set("TRIP:CAUSE", trip["cause"] if trip else "", at_s)
        self._set("TRIP:TEXT", trip["text"] if trip else "", at_s)
        self._set("STOPPED:TEXT", stop["text"] if stop else "", at_s)
        self._set("WARNINGS", "\n".join(state["warnings"]), at_s)
        for name, key in (("JOB:NAME", "name"), ("JOB:ID", "id"), ("JOB:PHASE", "phase")):
            self._set(name, str(job.get(key, "")), at_s)
        self._set("JOB:DONE", job.get("done_s", 0.0), at_s)
        self._set("JOB:TOTAL", job.get("total_s", 0.0), at_s)
        self._set("QUEUE", state["queue"], at_s)
        self._set("TICKS", state["ticks"]["done"], at_s)
        self._set("TICKS:MISSED", state["ticks"]["missed"], at_s)
        self._take_bench(state)
        self._judge_age(state)

    def _take_bench(self, state: dict[str, Any]) -> None:
        """Take limits and the drive's unit from the daemon, whose configuration may differ from ours."""
        limits = tuple(state["limits"]["temperature_degC"])
        if limits != self.limits_degC:
            self.limits_degC = (limits[0], limits[1])
            for field, value in zip(("LOLO", "HIHI", "LOPR", "HOPR"), limits * 2, strict=True):
                self._records["TEMPERATURE"].set_field(field, value)
        unit = str(state.get("drive_unit", "A"))
        if self._records["CURRENT"].get_field("EGU") != unit:
            self._records["CURRENT"].set_field("EGU", unit)

    def _judge_age(self, state: dict[str, Any]) -> None:
        """Set the alarms of readings that are too old or missing; take the first reading, before a row came."""
        reading = state["reading"]
        taken_s = reading.get("time_s")
        if state["state"] == "offline" or taken_s is None:
            self._readings_alarm(alarm.COMM_ALARM)
        elif state["time_s"] - taken_s > self._patience_s:
            self._readings_alarm(alarm.TIMEOUT_ALARM)
        else:
            self._take_row(reading)

    def _readings_alarm(self, what: int) -> None:
        for name, *_ in READINGS:
            self._records[name].set_alarm(alarm.INVALID_ALARM, what)

    def _set(self, name: str, value: Any, at_s: float, severity: int = 0, status: int = 0) -> None:
        if isinstance(value, str):
            value = shortened(value, SHORT if name in STRINGS else LONG - 1)
        self._records[name].set(value, severity=severity, alarm=status, timestamp=at_s)


def shortened(text: str, most: int) -> str:
    """Return text of at most so many bytes of UTF-8, without broken characters."""
    return text.encode("utf-8", "replace")[:most].decode("utf-8", "ignore")


def _number(words: tuple[tuple[str, ...], ...], word: str) -> int:
    """Return the index of a word; the last one if it is none of them."""
    return next((k for k, one in enumerate(words) if one[0] == word), len(words) - 1)


REMEMBERED = 100  # jobs whose last state is kept: far more than begin during one answer
BY = "EPICS"
BY_HAND = "NOT CONFIRMED off, switch the controller off by hand"
Place = Callable[[], Path]  # returns the daemon's present socket


class Answer(NamedTuple):
    """done: True if the command was carried out; text: for people; job: the id of a job that was taken."""

    done: bool
    text: str
    job: str = ""


def stop(place: Place) -> Answer:
    """Switch the output off; in every other case say that this is not confirmed."""
    try:
        with Client(place()) as client:
            answer = client.ask("POST", "/api/stop", by=BY)
    except (NoDaemon, Refusal) as error:
        return Answer(False, f"{BY_HAND}: {error}")
    if not answer.get("confirmed"):
        return Answer(False, BY_HAND)
    return Answer(True, f"off, confirmed ({answer['confirmed_by']}) after {1e3 * answer['took_s']:.0f} ms")


def command(place: Place, method: str, path: str, text: Callable[[Any], str], **body: Any) -> Answer:
    """Send another command; the text is made of the daemon's answer, or says why there is none."""
    try:
        with Client(place()) as client:
            answer = client.ask(method, path, **body)
    except Refusal as refusal:
        return Answer(False, "; ".join(refusal.lines))
    except NoDaemon as error:
        return Answer(False, str(error))
    return Answer(True, text(answer), str(answer.get("id", "")))


class InThreads:
    """softioc's dispatcher: each callback in a thread of its own."""

    def __call__(
        self,
        func: Callable[..., object],
        func_args: tuple[Any, ...] = (),
        completion: Callable[..., object] | None = None,
        completion_args: tuple[Any, ...] = (),
    ) -> None:
        """Call `func`, then `completion` in any case."""

        def work() -> None:
            try:
                func(*func_args)
            finally:
                if completion is not None:
                    completion(*completion_args)

        threading.Thread(target=work, name="EPICS command", daemon=True).start()


class StopRecord:
    """STOP, for everybody who reaches the server: writing any value switches the output off."""

    def __init__(self, place: Place) -> None:
        self._place = place
        builder.boolOut("STOP", ZNAM="", ONAM="STOP", initial_value=False, on_update=self._stop, **_fields(STOP))
        self._result = builder.longStringIn("STOP:RESULT", length=LONG, initial_value="")

    def _stop(self, _: object) -> None:
        _show(self._result, stop(self._place))


class Commands:
    """Records that only the users and hosts of the list may write."""

    def __init__(self, place: Place, published: Published) -> None:
        self._place, self._published = place, published
        setting = {"ASG": WRITE}
        self._degC = builder.aOut(
            "HOLD:TEMPERATURE", EGU="degC", PREC=3, initial_value=math.nan, validate=self._may_hold, **setting
        )
        self._seconds = builder.aOut(
            "HOLD:DURATION", EGU="s", PREC=1, initial_value=USUAL_S, validate=_may_last, **setting
        )
        self._name = builder.longStringOut("RUN:CONFIGURATION", length=LONG, initial_value="", **setting)
        for name, act in (("HOLD:START", self._hold), ("RUN:START", self._run), ("COMMAND:CANCEL", self._cancel)):
            builder.boolOut(name, ZNAM="", ONAM="do", initial_value=False, on_update=act, **_fields(WRITE))
        builder.longStringOut("RESET", length=LONG, initial_value="", on_update=self._reset, **_fields(WRITE))
        self._result = builder.longStringIn("COMMAND:RESULT", length=LONG, initial_value="")
        self._job = builder.stringIn("COMMAND:JOB", initial_value="")
        self._job_state = builder.stringIn("COMMAND:JOB_STATE", initial_value="")
        self._states: dict[str, str] = {}  # of each job: it may begin before the daemon's answer is here
        self._lock = threading.Lock()  # events come in a thread of their own

    def take(self, event: str, data: dict[str, Any]) -> None:
        """Take an event of the daemon; the job that was last started here is shown."""
        if event != "job":
            return
        with self._lock:
            self._states[data["id"]] = data["state"]
            while len(self._states) > REMEMBERED:
                del self._states[next(iter(self._states))]
            if data["id"] == self._job.get():
                self._job_state.set(shortened(data["state"], SHORT))

    def _may_hold(self, record: Any, degC: float) -> bool:
        low, high = self._published.limits_degC
        return _within(record, low < degC < high)

    def _hold(self, _: object) -> None:
        self._submit(hold_degC=self._degC.get(), hold_s=self._seconds.get())

    def _run(self, _: object) -> None:
        self._submit(configuration=self._name.get())

    def _submit(self, **body: Any) -> None:
        answer = command(self._place, "POST", "/api/jobs", lambda job: f"{job['name']}: {job['state']}", **body)
        if answer.done:
            with self._lock:
                self._job.set(shortened(answer.job, SHORT))
                self._job_state.set(shortened(self._states.get(answer.job, "queued"), SHORT))
        _show(self._result, answer)

    def _cancel(self, _: object) -> None:
        path = f"/api/jobs/{self._job.get()}"
        _show(self._result, command(self._place, "DELETE", path, lambda job: f"{job['name']}: ended", by=BY))

    def _reset(self, reason: str) -> None:
        text: Callable[[Any], str] = lambda answer: f"reset; {answer['queue']} jobs wait"  # noqa: E731
        _show(self._result, command(self._place, "POST", "/api/reset", text, reason=reason))


def _fields(group: str) -> dict[str, Any]:
    """Return the fields of a record that acts at every write, of the same value too, and is busy meanwhile."""
    return {"ASG": group, "always_update": True, "blocking": True}


def _show(record: Any, answer: Answer) -> None:
    """Show the answer, with an alarm if the command was not carried out."""
    severity, status = (0, 0) if answer.done else (alarm.MAJOR_ALARM, alarm.WRITE_ALARM)
    record.set(shortened(answer.text, LONG - 1), severity=severity, alarm=status)


def _may_last(record: Any, seconds: float) -> bool:
    return _within(record, SHORTEST_S <= seconds <= LONGEST_S)


def _within(record: Any, good: bool) -> bool:
    """Return True if a value is taken; if not, the alarm belongs to this very processing of the record."""
    if not good:
        record.process_severity(record._record, alarm.MAJOR_ALARM, alarm.HW_LIMIT_ALARM)
    return good
