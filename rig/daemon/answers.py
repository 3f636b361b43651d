"""What the daemon answers to each question; see `rig.daemon.control_socket` for the questions."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import SecretStr

from rig.config.configuration import read_configuration
from rig.core.faults import Faults
from rig.daemon.admission import by_name, by_text, configurations
from rig.daemon.client import CALIBRATION
from rig.daemon.desk import HISTORY, Desk
from rig.daemon.hold import USUAL_S, hold_of
from rig.daemon.job import Job
from rig.daemon.latching import NotCleared

LONGEST_REASON = 2000  # characters, a page of text: reasons are kept in the history
PRESSES_KEPT = 100  # of STOP: the page's second copy of a press comes within seconds


class Refusal(Exception):
    """A question that is not answered: an HTTP status that says so, and a line for each fault."""

    def __init__(self, status: int, lines: list[str]) -> None:
        self.status, self.lines = status, lines
        super().__init__("; ".join(lines))


class Answers:
    """The questions that may be asked of a desk."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._pressed: dict[str, dict[str, Any]] = {}  # presses of STOP that were confirmed, and their answers
        self._known: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "state": lambda _: {"state": desk.state()},
            "jobs": lambda _: {"jobs": desk.queue.tables()},
            "configurations": lambda _: {"configurations": configurations(desk.configurations)},
            "stop": self._stop,
            "reset": self._reset,
            "submit": self._submit,
            "cancel": self._cancel,
            "follow": self._follow,
            "who": self._who,
            "web": self._web,
        }

    def answer(self, question: dict[str, Any]) -> dict[str, Any]:
        """The answer to a question. Raises Refusal."""
        do = question.get("do")
        known = self._known.get(do) if isinstance(do, str) else None
        if known is None:
            raise Refusal(400, [f"do: {do!r}: expected one of {', '.join(self._known)}"])
        return known(question)

    def _stop(self, question: dict[str, Any]) -> dict[str, Any]:
        press = question.get("press")
        if isinstance(press, str) and press in self._pressed:
            return self._pressed[press]  # one press on two ways: what was reset since is not stopped by the later one
        by = question.get("by")
        off = self.desk.stop(by if isinstance(by, str) else "somebody")
        answer: dict[str, Any] = {"off": off.confirmed, "confirmed": off.confirmed, "took_s": off.took_s}
        answer["confirmed_by"] = off.confirmed_by
        if isinstance(press, str) and off.confirmed:
            self._pressed[press] = answer
            while len(self._pressed) > PRESSES_KEPT:
                self._pressed.pop(next(iter(self._pressed)), None)
        return answer

    def _reset(self, question: dict[str, Any]) -> dict[str, Any]:
        reason = _text(question, "reason", "").strip()
        if not reason:
            raise Refusal(422, ["reason: missing; expected why it is safe to go on"])
        try:
            done = self.desk.reset(reason[:LONGEST_REASON])
        except NotCleared as error:
            raise Refusal(503, [f"not reset: {error}"]) from None
        if not done:
            raise Refusal(409, ["nothing is latched; expected a trip or a stop"])
        return {"reset": True, "queue": len(self.desk.queue)}

    def _submit(self, question: dict[str, Any]) -> dict[str, Any]:
        folder = self.desk.configurations
        name, kind, out = question.get("name"), question.get("kind"), None
        if kind not in (None, CALIBRATION):
            raise Refusal(422, [f"kind: {kind!r}: expected {CALIBRATION!r}, or none for the experiment itself"])
        experiment = kind != CALIBRATION
        try:
            if isinstance(question.get("path"), str):
                path = Path(question["path"])
                file = read_configuration(path, experiment)
                name = name or path.stem
                out = Path(question["out"]) if isinstance(question.get("out"), str) else None
            elif "configuration" in question:
                file = by_name(question["configuration"], folder, experiment)
                name = name or str(question["configuration"])
            elif "text" in question:
                file = by_text(question["text"], name, folder, experiment)
            elif "hold_degC" in question and experiment:
                seconds = question.get("hold_s", USUAL_S)
                file = hold_of(self.desk.file, question["hold_degC"], seconds, self.desk.model)
                name = name or f"hold {float(question['hold_degC']):g} degC"
            else:
                raise Refusal(422, ["configuration: missing; expected a name, a text, or hold_degC"])
            job = self.desk.submit(file, str(name)[:80] if name else None, out, kind)
        except Faults as faults:
            raise Refusal(422, faults.lines) from None
        return {"job": job.table()}

    def _cancel(self, question: dict[str, Any]) -> dict[str, Any]:
        number = _text(question, "id", "")
        job = self.desk.cancel(number, _text(question, "by", "somebody"))
        if job is None:
            raise Refusal(404, [f"job {number!r}: expected one that waits or runs"])
        return {"job": job.table(), "state": self.desk.state()}

    def _follow(self, question: dict[str, Any]) -> dict[str, Any]:
        """A job with what it said and what came out."""
        job: Job | None = self.desk.queue.find(_text(question, "id", ""))
        if job is None:
            raise Refusal(404, ["id: expected a job that waits, runs, or has just ended"])
        return {"job": job.table(), "said": job.said, "result": job.result}

    def _who(self, question: dict[str, Any]) -> dict[str, Any]:
        """Which process this is, whose configuration it serves, and what ports it holds."""
        file = self.desk.file
        bench = file.content.bench
        ports = [bench.controller.port, *([bench.meter.port] if bench.meter else [])]
        name = file.content.serve.name
        return {"pid": os.getpid(), "name": name, "configuration": str(file.path), "ports": ports}

    def _web(self, question: dict[str, Any]) -> dict[str, Any]:
        """What the web process needs to know."""
        desk = self.desk
        serve = desk.file.content.serve
        return {
            "pid": os.getpid(),
            "address": serve.address,
            "port": serve.port,
            "stop_port": desk.stop_port,
            "token": _revealed(serve.token),
            "metrics_token": _revealed(serve.metrics_token),
            "hosts": serve.hosts,
            "history": str(desk.folder / HISTORY),
            "period_s": serve.idle_period_s,
            "model": str(desk.model) if desk.model is not None else None,
            "memory_since_s": desk.memory_since_s,
            "limits_degC": list(desk.file.content.limits.temperature_degC),
        }


def _revealed(secret: SecretStr | None) -> str | None:
    """For the web process, which compares it; the socket belongs to one user."""
    return secret.get_secret_value() if secret is not None else None


def _text(question: dict[str, Any], key: str, otherwise: str) -> str:
    value = question.get(key, otherwise)
    if not isinstance(value, str):
        raise Refusal(422, [f"{key}: {type(value).__name__}: expected text"])
    return value
