"""Records that can be written: STOP, for everybody; with [epics] write also hold, run, cancel and reset.

A command's record is busy until the daemon has answered, so that a put that waits (`caput -c`, `wait=True`) has then
been carried out; each has a thread of its own, so that STOP waits for none of the others. A value beyond its limits is
refused: the record keeps the old one and has a MAJOR alarm (HWLIMIT) until a valid one is written.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from softioc import alarm, builder

from rig.daemon.client import Client, NoDaemon, Refusal
from rig.daemon.configurations import LONGEST_S, SHORTEST_S, USUAL_S
from rig.epics.access import STOP, WRITE
from rig.epics.published import LONG, SHORT, Published, shortened

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
            answer = client.stop(BY)
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
