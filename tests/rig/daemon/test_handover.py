"""How a job that was handed over ends, where the daemon goes at the same time or cannot answer for the output."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rig.daemon import handover
from rig.daemon.client import NoDaemon
from rig.guard.stale_run import DIED, end_of_last_run, write_end

OFF = {"state": "idle", "job": None, "output": "off", "output_confirmed": True, "output_confirmed_by": "the controller"}
NOT_CONFIRMED = {**OFF, "output": "unknown", "output_confirmed": False, "output_confirmed_by": None}
NEXT_JOB = {**NOT_CONFIRMED, "state": "running", "job": {"id": "8"}}
GONE = None
Hand = Callable[["_Daemon"], tuple[int, str, str]]


def state_of(state: dict[str, Any]) -> dict[str, Any]:
    return {"event": "state", "data": state}


def job_of(number: str, **more: Any) -> dict[str, Any]:
    return {"event": "job", "data": {"id": number, **more}}


class _Daemon:
    """Answers as a daemon does; `state` None: it has gone."""

    path = Path("bench.sock")

    def __init__(self, status: int, state: dict[str, Any] | None) -> None:
        self._status, self._state = status, state
        self.asked: list[str] = []
        # in place of the job's end: what it tells, and what happens in between; then it goes
        self.tells: list[dict[str, Any] | Callable[[], object]] = []
        self.cancelled = {"id": "7", "state": "running"}  # the answer to DELETE
        self.signals: dict[str, signal.Signals] = {}  # that come while something is asked or told

    def _signalled(self, when: str) -> None:
        if when in self.signals:
            signal.raise_signal(self.signals[when])

    def ask(self, method: str, at: str, /, **body: Any) -> dict[str, Any]:
        self.asked.append(method)
        if method == "POST":
            self._signalled("POST")
            return {"id": "7"}
        if self._state is None:
            raise NoDaemon("the daemon is silent")
        if method == "DELETE":
            return {**self.cancelled, "bench": self._state}
        return self._state if at == "/api/state" else {"result": {"rows": 3}}

    def events(self, silence_s: float) -> Any:
        yield state_of(OFF)
        for each in self.tells:
            if isinstance(each, dict):
                yield each
            else:
                each()
        if self.tells:
            raise NoDaemon("the daemon has ended")
        self._signalled("follow")
        yield self.ends()

    def ends(self) -> dict[str, Any]:
        """Return the message of the job's end."""
        reason = None if self._status == 0 else "the film is too hot"
        return job_of("7", ended_s=1.0, exit_status=self._status, reason=reason, folder="runs/7")


class _Held:
    """The daemon as the client that a `with` gives."""

    def __init__(self, daemon: _Daemon) -> None:
        self._daemon = daemon
        self.path = daemon.path
        self.name = daemon.path.stem

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *what: object) -> None:
        pass

    def ask(self, method: str, at: str, /, **body: Any) -> dict[str, Any]:
        return {"ports": ["/dev/one"]} if at == "/daemon" else self._daemon.ask(method, at, **body)

    def events(self, silence_s: float) -> Any:
        return self._daemon.events(silence_s)


@pytest.fixture
def hand(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Hand:
    """Hand a run over to a daemon: its exit status, what it printed on stdout and on stderr."""

    def over(daemon: _Daemon) -> tuple[int, str, str]:
        monkeypatch.setattr(handover, "_ports", lambda config: {"/dev/one"})
        monkeypatch.setattr(handover, "daemons", lambda: [_Held(daemon)])
        monkeypatch.setattr(handover, "Client", lambda path, silence_s: _Held(daemon))
        monkeypatch.setattr(handover, "GUARD_S", 0.01)
        status = handover.handed_over("run", tmp_path / "config.toml", None)
        assert status is not None
        return (status, *capsys.readouterr())

    return over


@pytest.mark.parametrize(
    ("status", "state", "expected", "said"),
    [
        (0, OFF, 0, "output off, confirmed"),
        (0, NEXT_JOB, 0, "for the bench's present work"),
        (0, NOT_CONFIRMED, 11, "OUTPUT NOT CONFIRMED OFF"),
        (0, GONE, 11, "OUTPUT NOT CONFIRMED OFF"),
        (10, OFF, 10, "output off, confirmed"),
        (10, NEXT_JOB, 10, "for the bench's present work"),
        (10, NOT_CONFIRMED, 11, "OUTPUT NOT CONFIRMED OFF"),
        (10, GONE, 11, "OUTPUT NOT CONFIRMED OFF"),
    ],
)
def test_an_output_that_nobody_answers_for_outranks_the_jobs_status(
    status: int, state: dict[str, Any] | None, expected: int, said: str, hand: Hand
) -> None:
    daemon = _Daemon(status, state)
    found, out, err = hand(daemon)
    assert found == expected
    assert said in (err if expected else out)


def test_the_last_word_of_a_daemon_that_ends_with_its_job_counts(hand: Hand) -> None:
    """On SIGTERM it tells of the job's end and of its output, and may be gone before it is asked."""

    daemon = _Daemon(143, GONE)
    daemon.tells = [daemon.ends(), {"event": "row", "data": {}}, state_of(OFF)]
    found, _, err = hand(daemon)
    assert found == 143
    assert "output off, confirmed by the controller (the controller)" in err


@pytest.mark.parametrize("when", ["POST", "follow"])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_a_signal_ends_the_job_from_the_moment_it_is_submitted(when: str, name: str, hand: Hand) -> None:
    daemon, number = _Daemon(0, OFF), getattr(signal, name, None)
    if number is None:
        pytest.skip(f"no {name} here")
    daemon.signals[when] = number
    found, _, err = hand(daemon)
    assert found == 128 + number
    assert daemon.asked == ["POST", "DELETE"]  # what answers has switched off, and says so: it may be gone then
    assert f"stopped by {name}; output off, confirmed" in err


@pytest.mark.parametrize(
    ("job", "said"),
    [("stopped", "the job had not begun"), ("running", "its output was off before the next job began")],
)
def test_another_jobs_output_is_no_matter_of_one_that_is_ended(job: str, said: str, hand: Hand) -> None:
    daemon = _Daemon(0, {**NEXT_JOB, "output": "on", "output_confirmed": True})
    daemon.cancelled["state"], daemon.signals["follow"] = job, signal.SIGTERM
    found, _, err = hand(daemon)
    assert found == 128 + signal.SIGTERM
    assert said in err


def test_a_daemon_that_goes_over_the_answer_may_have_begun_the_job(hand: Hand) -> None:
    class Gone(_Daemon):
        def ask(self, method: str, at: str, /, **body: Any) -> dict[str, Any]:
            raise NoDaemon("the daemon has ended")

    found, _, err = hand(Gone(0, OFF))
    assert found == 11
    assert "OUTPUT NOT CONFIRMED OFF" in err


FREE = {**OFF, "no_job_because": [], "drive_unit": "A", "time_s": 3.0}
WAITS = {**FREE, "state": "running", "job": {"id": "8"}}
BEGUN = {**WAITS, "job": {"id": "7"}}
HELD = {**FREE, "state": "tripped"}


@pytest.mark.parametrize(
    ("told", "status", "said"),
    [
        ([WAITS], 1, "the job never began: the daemon has ended while it waited"),
        ([HELD], 1, "the job never began"),
        ([BEGUN], 11, "OUTPUT NOT CONFIRMED OFF: the daemon has ended while the job ran"),
        ([WAITS, BEGUN], 11, "while the job ran"),
        ([WAITS, FREE], 11, "while the job ran"),  # it may have begun since
        ([WAITS, None], 11, "while the job ran"),  # the other job has ended
    ],
)
def test_a_job_that_waited_when_its_daemon_was_killed_never_began(
    told: list[dict[str, Any] | None], status: int, said: str, hand: Hand, tmp_path: Path
) -> None:
    daemon = _Daemon(0, GONE)
    daemon.tells = [job_of("8", started_s=0.0, ended_s=1.0) if state is None else state_of(state) for state in told]
    found, _, err = hand(daemon)
    assert found == status
    assert said in err
    assert f"`peltier off {tmp_path / 'config.toml'}` switches the output off" in err
    assert ("submit it again" in err) == (status == 1)


@pytest.mark.parametrize(("state", "status"), [("queued", 1), ("running", 11)])
def test_a_job_that_waited_when_its_daemon_ended_never_began(state: str, status: int, hand: Hand) -> None:
    """By itself: it ends the job before this one, lets its listeners go, and answers for a moment more."""

    class Ends(_Daemon):
        def ask(self, method: str, at: str, /, **body: Any) -> dict[str, Any]:
            if at == "/api/jobs/7" and method not in self.asked:
                self.asked.append(method)
                return {"job": {"id": "7", "state": state}}
            return super().ask(method, at, **body)

    daemon = Ends(0, GONE)
    daemon.tells = [state_of(WAITS), job_of("8", started_s=0.0, ended_s=1.0, folder="runs/8"), state_of(FREE)]
    found, _, err = hand(daemon)
    assert found == status
    assert ("the job never began" in err) == (status == 1)
    assert "runs/8" not in err  # another job's


@pytest.mark.parametrize(
    ("confirmed", "status", "said"),
    [
        (True, 1, "its guard: process 5 died of SIGKILL; output off, confirmed"),
        (False, 11, "OUTPUT NOT CONFIRMED OFF: its guard: process 5 died of SIGKILL"),
        (None, 11, "its guard's finding is in the daemon's log, and in {folder}/run.json"),
    ],
)
def test_a_job_whose_daemon_was_killed_ends_as_its_guard_found(
    confirmed: bool | None, status: int, said: str, hand: Hand, tmp_path: Path
) -> None:
    """The guard writes it into the folder of the run that went on, which is known from the job's first word."""
    folder = tmp_path / "7.part"
    folder.mkdir()
    (folder / "run.json").write_text('{"start": {}}')

    daemon = _Daemon(0, GONE)
    daemon.tells = [job_of("7", started_s=1.0, ended_s=None, folder=str(folder))]
    if confirmed is not None:
        died = "process 5 died of SIGKILL; output off, confirmed"
        daemon.tells.append(lambda: write_end(str(folder), died, confirmed))
    found, _, err = hand(daemon)
    assert found == status
    assert said.format(folder=folder) in err


@pytest.mark.parametrize(
    ("calibrated_at", "reason", "confirmed", "status", "said"),
    [
        ("1", DIED, True, 1, "its guard: as it is; what was recorded is in"),
        ("1", "signal", True, 1, "its run: as it is; output off, confirmed; what was recorded is in"),
        ("1", "signal", False, 11, "OUTPUT NOT CONFIRMED OFF: its run: as it is; output not confirmed off"),
        ("3", "signal", False, 11, "OUTPUT NOT CONFIRMED OFF: its run: as it is; output not confirmed off"),
    ],
)
def test_a_job_that_is_ended_while_its_daemon_ends(
    calibrated_at: str, reason: str, confirmed: bool, status: int, said: str, hand: Hand, tmp_path: Path
) -> None:
    """Nobody answers to the Ctrl-C: what is written of the run's end counts, not that of the calibration before it, and
    a clock that was set back in between makes no "confirmed" of one that is not."""
    folder = tmp_path / "7.part"
    ends = {"calibration": (calibrated_at, "done", True), "": ("2", reason, confirmed)}
    for name, (at, why, off) in ends.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        stop = {"reason": why, "text": "as it is", "output_off_confirmed": off}
        (folder / name / "run.json").write_text(json.dumps({"start": {"at": at}, "stop": stop}))

    daemon = _Daemon(0, GONE)
    begun = job_of("7", started_s=1.0, ended_s=None, folder=str(folder))
    daemon.tells = [begun, lambda: signal.raise_signal(signal.SIGINT)]
    found, _, err = hand(daemon)
    assert found == status
    assert said in err


def test_a_run_that_has_not_ended_is_waited_for_whatever_the_clock_says(tmp_path: Path) -> None:
    """The guard checks the temperature for 20 s: until then a calibration of before must not speak for the output."""
    for name, at, stop in (("calibration", "3", {"reason": "done", "output_off_confirmed": True}), ("", "2", None)):
        (tmp_path / name).mkdir(exist_ok=True)
        run = {"start": {"at": at}, **({"stop": stop} if stop is not None else {})}
        (tmp_path / name / "run.json").write_text(json.dumps(run))
    assert end_of_last_run(str(tmp_path), 0.0) is None
    write_end(str(tmp_path), "still warm", confirmed=False)
    assert end_of_last_run(str(tmp_path), 0.0) == (False, "its guard: still warm")
