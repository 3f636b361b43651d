"""How a job that was handed over ends, where the daemon goes at the same time or cannot answer for the output."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rig.daemon import handover
from rig.daemon.client import NoDaemon

OFF = {"state": "idle", "job": None, "output": "off", "output_confirmed": True, "output_confirmed_by": "the controller"}
NOT_CONFIRMED = {**OFF, "output": "unknown", "output_confirmed": False, "output_confirmed_by": None}
NEXT_JOB = {**NOT_CONFIRMED, "state": "running", "job": {"id": "8"}}
GONE = None


class _Daemon:
    """Answers as a daemon does; `state` None: it has gone."""

    path = Path("bench.sock")

    def __init__(self, status: int, state: dict[str, Any] | None) -> None:
        self._status, self._state = status, state

    def ask(self, verb: str, **more: Any) -> dict[str, Any]:
        if verb == "submit":
            return {"ok": True, "job": {"id": "7"}}
        if self._state is None:
            raise NoDaemon("the daemon is silent")
        return {"state": self._state} if verb == "state" else {"result": {"rows": 3}}

    def events(self, silence_s: float) -> Any:
        yield {"event": "state", "data": OFF}
        reason = None if self._status == 0 else "the film is too hot"
        job = {"id": "7", "ended_s": 1.0, "exit_status": self._status, "reason": reason, "folder": "runs/7"}
        yield {"event": "job", "data": job}


@pytest.mark.parametrize(
    ("status", "state", "expected", "said"),
    [
        (0, OFF, 0, "output off, confirmed"),
        (0, NEXT_JOB, 0, "for what the bench does now"),
        (0, NOT_CONFIRMED, 11, "OUTPUT NOT CONFIRMED OFF"),
        (0, GONE, 11, "OUTPUT NOT CONFIRMED OFF"),
        (10, OFF, 10, "output off, confirmed"),
        (10, NEXT_JOB, 10, "for what the bench does now"),
        (10, NOT_CONFIRMED, 11, "OUTPUT NOT CONFIRMED OFF"),
        (10, GONE, 11, "OUTPUT NOT CONFIRMED OFF"),
    ],
)
def test_an_output_that_nobody_answers_for_outranks_the_jobs_status(
    status: int,
    state: dict[str, Any] | None,
    expected: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    daemon = _Daemon(status, state)
    monkeypatch.setattr(handover, "_ports", lambda config: {"/dev/one"})
    monkeypatch.setattr(handover, "daemons", lambda: [_Held(daemon)])
    monkeypatch.setattr(handover, "Client", lambda path, silence_s: _Held(daemon))
    assert handover.handed_over("run", tmp_path / "config.toml", None) == expected
    out, err = capsys.readouterr()
    assert said in (err if expected else out)


class _Held:
    """The daemon as the client that a `with` gives."""

    def __init__(self, daemon: _Daemon) -> None:
        self._daemon = daemon
        self.path = daemon.path

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *what: object) -> None:
        pass

    def ask(self, verb: str, **more: Any) -> dict[str, Any]:
        return {"ports": ["/dev/one"]} if verb == "who" else self._daemon.ask(verb, **more)

    def events(self, silence_s: float) -> Any:
        return self._daemon.events(silence_s)
