"""The records that are written to: STOP, for everybody; with [epics] write also hold, run, cancel and reset.

A command's record is busy until the daemon has answered, so that a put that waits (`caput -c`, `wait=True`) has then
been carried out; each has a thread of its own, so that STOP waits for none of the others. A value beyond its limits is
refused: the record keeps the old one and has a MAJOR alarm (HWLIMIT) until it is written rightly.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from softioc import alarm, builder

from rig.daemon.hold import LONGEST_S, USUAL_S
from rig.epics import questions
from rig.epics.access import STOP, WRITE
from rig.epics.published import LONG, SHORT, Published, shortened
from rig.epics.questions import Answer, Place

SHORTEST_S = 1.0  # as the daemon has it
REMEMBERED = 100  # jobs whose last state is kept: far more than begin within the time of one answer


class InThreads:
    """How softioc calls back: each call in a thread of its own."""

    def __call__(
        self,
        func: Callable[..., object],
        func_args: tuple[Any, ...] = (),
        completion: Callable[..., object] | None = None,
        completion_args: tuple[Any, ...] = (),
    ) -> None:
        """Call `func`, and `completion` after it whatever came of that."""

        def work() -> None:
            try:
                func(*func_args)
            finally:
                if completion is not None:
                    completion(*completion_args)

        threading.Thread(target=work, name="EPICS command", daemon=True).start()


class Stopping:
    """STOP, for everybody who reaches the server: any value that is written switches the output off."""

    def __init__(self, place: Place) -> None:
        self._place = place
        builder.boolOut("STOP", ZNAM="", ONAM="STOP", initial_value=False, on_update=self._stop, **_command(STOP))
        self._result = builder.longStringIn("STOP:RESULT", length=LONG, initial_value="")

    def _stop(self, _: object) -> None:
        _tell(self._result, questions.stop(self._place))


class Commands:
    """What only those of the list may write."""

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
            builder.boolOut(name, ZNAM="", ONAM="do", initial_value=False, on_update=act, **_command(WRITE))
        builder.longStringOut("RESET", length=LONG, initial_value="", on_update=self._reset, **_command(WRITE))
        self._result = builder.longStringIn("COMMAND:RESULT", length=LONG, initial_value="")
        self._job = builder.stringIn("COMMAND:JOB", initial_value="")
        self._job_state = builder.stringIn("COMMAND:JOB_STATE", initial_value="")
        self._states: dict[str, str] = {}  # of each job, as last told: it may begin before the daemon's answer is here
        self._telling = threading.Lock()  # events come in a thread of their own

    def take(self, event: str, data: dict[str, Any]) -> None:
        """What the daemon tells of its jobs; the one that was last started here is shown."""
        if event != "job":
            return
        with self._telling:
            self._states[data["id"]] = data["state"]
            while len(self._states) > REMEMBERED:
                del self._states[next(iter(self._states))]
            if data["id"] == self._job.get():
                self._job_state.set(shortened(data["state"], SHORT))

    def _may_hold(self, record: Any, degC: float) -> bool:
        low, high = self._published.limits_degC
        return _within(record, low < degC < high)

    def _hold(self, _: object) -> None:
        self._started(questions.submit(self._place, hold_degC=self._degC.get(), hold_s=self._seconds.get()))

    def _run(self, _: object) -> None:
        self._started(questions.submit(self._place, configuration=self._name.get()))

    def _started(self, answer: Answer) -> None:
        if answer.done:
            with self._telling:
                self._job.set(shortened(answer.job, SHORT))
                self._job_state.set(shortened(self._states.get(answer.job, "queued"), SHORT))
        _tell(self._result, answer)

    def _cancel(self, _: object) -> None:
        _tell(self._result, questions.cancel(self._place, self._job.get()))

    def _reset(self, reason: str) -> None:
        _tell(self._result, questions.reset(self._place, reason))


def _command(group: str) -> dict[str, Any]:
    """A record that acts at every write, the same value included, and is busy meanwhile."""
    return {"ASG": group, "always_update": True, "blocking": True}


def _tell(record: Any, answer: Answer) -> None:
    """The answer in words, with an alarm where what was asked was not done."""
    severity, status = (0, 0) if answer.done else (alarm.MAJOR_ALARM, alarm.WRITE_ALARM)
    record.set(shortened(answer.text, LONG - 1), severity=severity, alarm=status)


def _may_last(record: Any, seconds: float) -> bool:
    return _within(record, SHORTEST_S <= seconds <= LONGEST_S)


def _within(record: Any, good: bool) -> bool:
    """Whether a value is taken; where it is not, the alarm belongs to this very processing of the record."""
    if not good:
        record.process_severity(record._record, alarm.MAJOR_ALARM, alarm.HW_LIMIT_ALARM)
    return good
