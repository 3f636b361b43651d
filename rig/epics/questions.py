"""Questions to the daemon that are asked on behalf of an EPICS client, and their answers in words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rig.daemon.client import Client, NoDaemon

BY = "EPICS"
Place = Callable[[], Path]  # where the daemon listens, as of now


class Answer(NamedTuple):
    """done: whether what was asked was done. text: for people. job: the id of a job that was taken."""

    done: bool
    text: str
    job: str = ""


def stop(place: Place) -> Answer:
    """The output off; whatever goes wrong, it says that this is not confirmed."""
    try:
        answer = _asked(place, "stop", by=BY)
    except NoDaemon as error:
        return Answer(False, f"NOT CONFIRMED off, switch the controller off by hand: {error}")
    if not (answer.get("ok") and answer.get("confirmed")):
        faults = "".join(f": {line}" for line in answer.get("faults", []))
        return Answer(False, f"NOT CONFIRMED off, switch the controller off by hand{faults}")
    return Answer(True, f"off, confirmed ({answer['confirmed_by']}) after {1e3 * answer['took_s']:.0f} ms")


def submit(place: Place, **what: Any) -> Answer:
    """A job: what is asked for as in docs/bench_api.md."""
    answer = _answered(place, "submit", **what)
    if isinstance(answer, Answer):
        return answer
    job = answer["job"]
    return Answer(True, f"{job['name']}: {job['state']}", job["id"])


def cancel(place: Place, job: str) -> Answer:
    """A job taken out of the queue, or ended."""
    answer = _answered(place, "cancel", id=job, by=BY)
    return answer if isinstance(answer, Answer) else Answer(True, f"{answer['job']['name']}: ended", job)


def reset(place: Place, reason: str) -> Answer:
    """Clear what is latched; without a reason the daemon refuses."""
    answer = _answered(place, "reset", reason=reason)
    return answer if isinstance(answer, Answer) else Answer(True, f"reset; {answer['queue']} jobs wait")


def _answered(place: Place, do: str, **more: Any) -> dict[str, Any] | Answer:
    """The daemon's answer, or why there is none."""
    try:
        answer = _asked(place, do, **more)
    except NoDaemon as error:
        return Answer(False, str(error))
    return answer if answer.get("ok") else Answer(False, "; ".join(map(str, answer.get("faults", []))) or "refused")


def _asked(place: Place, do: str, **more: Any) -> dict[str, Any]:
    with Client(place()) as client:
        return client.ask(do, **more)
