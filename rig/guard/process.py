"""`guarded`: fork, let the child hold the ports, and be there when it dies.

The guard forwards INT, TERM, HUP and QUIT, and passes the child's exit status on. When the child ends, of whatever,
without having said that it let go of the output with the output confirmed off, the guard opens the controller's port
itself and commands it off: exit status 11 where that is not confirmed, else 128 + n for a child that died of signal n.
After a confirmation the guard goes on reading the temperature, where the child had told what it would show
(`rig.safety.after_off`): a controller that only says that it is off is not believed, and that is status 11 as well.
How it ended is told on stderr, and written into the folder of the run that was going on. Nothing waits for whoever
reads stderr but the guard's own end: everything is done by then.
A child that has told itself that the output is not confirmed off (status 11) is not contradicted. Either way, where the
output had been armed, a detached process keeps trying (`rig.guard.keep_trying`).
A child that has armed the output and completes no tick for `silence_s`, or is suspended, is ended: the dead man of
instruments that have none of their own. Ctrl-Z is ignored, an armed output cannot be put to sleep.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import math
import os
import selectors
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from rig.core.outcome import NotConfirmedOff
from rig.core.patient_lines import PatientLines
from rig.guard.keep_trying import keep_trying
from rig.guard.last_breath import LastBreath
from rig.guard.left_behind import Left, begin_report, write_end
from rig.guard.line import UNGUARDED, Guard, GuardLine
from rig.guard.takeover import Held, look_once_more, off_at_once, prepare, sentence, switch_off, temperature_after
from rig.safety.after_off import Courses, courses_of
from rig.safety.signals import CAUGHT
from rig.safety.switching_off import Verdict

# longer than anything that a run computes with the output on; controllers' own dead men are sooner
SILENCE_S = 30.0
PATIENCE_S = 3.0  # for an adapter that comes back
FRESH_S = 3.0  # what a temperature would do is told twice a second; later the plate is elsewhere
GRACE_S = 3.0  # from SIGTERM to SIGKILL for a child that hangs
PR_SET_PDEATHSIG = 1


def guarded(work: Callable[[Guard], int], *, silence_s: float = SILENCE_S, patience_s: float = PATIENCE_S) -> int:
    """Do `work` in a child process under guard; returns the exit status.

    Call it from the main thread, before threads and large imports. It returns in the guard, and in the child as well,
    with what `work` returned (or raises what it raised): nothing but the way out may follow. silence_s: an armed loop
    that completes no tick for so long is ended. patience_s: for how long a port that cannot be opened is tried again.
    Where there is no fork `work` is done without a guard, and that is told.
    """
    if not hasattr(os, "fork") or threading.current_thread() is not threading.main_thread():
        print("no guard process here: the output depends on this process alone", file=sys.stderr)
        return work(UNGUARDED)
    sys.stdout.flush()
    sys.stderr.flush()
    reader, writer = os.pipe()
    last_breath = _last_breath()
    with _Signals() as signals:
        guard_pid = os.getpid()
        child = os.fork()
        if child:
            os.close(writer)
            watch = _Watch(child, reader, signals, last_breath, silence_s, patience_s)
            try:
                return watch.until_it_ends()
            finally:
                watch.tell.close(None)
    os.close(reader)
    _die_with(guard_pid)
    return work(GuardLine(writer, guard_pid, last_breath))


def _last_breath() -> LastBreath | None:
    """None where the system has none: the guard then hears of a death some ms later."""
    try:
        return LastBreath()
    except (OSError, AttributeError):
        return None


def _die_with(guard_pid: int) -> None:
    """SIGTERM to this process when the guard dies (Linux); elsewhere the broken pipe tells."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != guard_pid:  # it died before that
        os._exit(128 + signal.SIGTERM)


class _Signals:
    """Context in which signals only wake `select`, as bytes in a pipe; Ctrl-Z is ignored, for the child as well."""

    def __enter__(self) -> _Signals:
        self.reader, self.writer = os.pipe()
        os.set_blocking(self.reader, False)
        os.set_blocking(self.writer, False)
        self._pid = os.getpid()
        self._wakeup = signal.set_wakeup_fd(self.writer, warn_on_full_buffer=False)
        self._before = {n: signal.signal(n, lambda number, frame: None) for n in (*CAUGHT, signal.SIGCHLD)}
        self._suspend = signal.signal(signal.SIGTSTP, signal.SIG_IGN)
        return self

    def __exit__(self, *_: object) -> None:
        """As before, in the guard and in the child; in the child Ctrl-Z stays ignored."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup)
        if os.getpid() == self._pid:
            signal.signal(signal.SIGTSTP, self._suspend)
        os.close(self.reader)
        os.close(self.writer)


class _Watch:
    """The guard's own loop."""

    def __init__(
        self,
        child: int,
        reader: int,
        signals: _Signals,
        last_breath: LastBreath | None,
        silence_s: float,
        patience_s: float,
    ) -> None:
        self._child, self._reader, self._signals, self._last_breath = child, reader, signals, last_breath
        self._silence_s, self._patience_s = silence_s, patience_s
        self._held: dict[str, Held] = {}
        self._busy = False
        self._given_up = False
        self._given_up_before = False  # the same, before the controller's port was tried to be opened anew
        self._heard_s = time.monotonic()
        self._end_s: float | None = None  # when a child that hangs is killed
        self._text = b""
        self._at_once: Verdict | None = None
        self._courses: Courses | None = None
        self._courses_s = -math.inf  # when they were told
        self._left: Left | None = None
        self.tell = PatientLines("peltier guard")

    def until_it_ends(self) -> int:
        """Wait for the child's end; what it left on is switched off then."""
        os.set_blocking(self._reader, False)
        with selectors.DefaultSelector() as selector:
            selector.register(self._reader, selectors.EVENT_READ)
            selector.register(self._signals.reader, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select(self._wait_s()):
                    if key.fd == self._signals.reader:
                        self._hear()
                    elif not self._listen():
                        selector.unregister(self._reader)
                ended, code = os.waitpid(self._child, os.WNOHANG | os.WUNTRACED)
                if ended and os.WIFSTOPPED(code):
                    self._suspended()
                elif ended:
                    break
                self._look_for_silence()
        self._listen()
        os.close(self._reader)
        return self._status(os.waitstatus_to_exitcode(code))

    def _wait_s(self) -> float | None:
        due = [self._end_s] if self._end_s is not None else []
        if self._busy and not self._given_up and self._end_s is None:
            due.append(self._heard_s + self._silence_s)
        return max(min(due) - time.monotonic(), 0.0) if due else None

    def _hear(self) -> None:
        """Signals are passed on; a 0 is the child's last breath."""
        with contextlib.suppress(BlockingIOError):
            for number in os.read(self._signals.reader, 256):
                if number in CAUGHT:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(self._child, number)
                elif number == 0:
                    self._listen()
                    controller = self._held.get("controller")
                    if controller is not None and not self._given_up:
                        self._at_once = off_at_once(controller)

    def _listen(self) -> bool:
        """Take in what the child has told; False at the end of the pipe."""
        while True:
            try:
                data = os.read(self._reader, 65536)
            except BlockingIOError:
                return True
            if not data:
                return False
            self._heard_s = time.monotonic()
            *lines, self._text = (self._text + data).split(b"\n")
            for line in lines:
                if line != b".":
                    self._take(json.loads(line))

    def _take(self, message: dict[str, object]) -> None:
        event = message.pop("event")
        if event == "begun" and self._last_breath is not None:
            self._last_breath.write_when_it_ends(self._signals.writer)
        elif event == "holds":
            held = Held(**message)  # type: ignore[arg-type]
            self._held[held.role] = held
            if held.role == "controller":
                self._given_up_before, self._given_up = self._given_up, False
            with contextlib.suppress(Exception):  # tried again, and told, when it is needed
                prepare(held)
        elif event == "let_go":
            self._held, self._busy, self._given_up = {}, False, False
        elif event == "not_opened" and self._given_up_before:
            self._given_up = True
        elif event == "not_opened":
            self._held, self._busy = {}, False
        elif event == "given_up":
            self._given_up = True
        elif event == "expects":
            table: Any = message["courses"]
            self._courses = courses_of(table) if table is not None else None
            self._courses_s = time.monotonic()
        elif event == "records":
            self._left = Left(**message) if message["folder"] else None  # type: ignore[arg-type]
        else:
            self._busy, self._courses = event == "busy", None
            if self._busy:  # the output is armed anew: that an earlier off was not confirmed is told, and over
                self._given_up = False
            self._heard_s = time.monotonic()

    def _look_for_silence(self) -> None:
        now = time.monotonic()
        if self._end_s is not None:
            if now >= self._end_s:
                os.kill(self._child, signal.SIGKILL)
                self._end_s = now + GRACE_S
        elif self._busy and not self._given_up and now - self._heard_s >= self._silence_s:
            os.kill(self._child, signal.SIGTERM)
            self._end_s = now + GRACE_S
            self.tell(f"process {self._child}: no tick for {self._silence_s:g} s with the output armed: ending it")

    def _suspended(self) -> None:
        """A process that is suspended controls nothing."""
        if self._held:
            os.kill(self._child, signal.SIGKILL)
            self.tell(f"process {self._child} was suspended while it holds the controller: ending it")

    def _status(self, code: int) -> int:
        """The exit status, after the output was switched off where the child did not say that it is."""
        status = 128 - code if code < 0 else code
        how = f"died of {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"
        controller, meter = self._held.get("controller"), self._held.get("meter")
        if controller is None:
            if code < 0:
                self.tell(f"process {self._child} {how}; it held no controller")
            return status
        if self._given_up or status == NotConfirmedOff.exit_status:  # it has said so: nobody says otherwise any more
            if not self._given_up:
                switch_off(controller, self._patience_s)
            return self._not_confirmed(controller)
        verdict = self._verdict(controller)
        if not verdict.confirmed:
            return self._not_confirmed(controller, f"process {self._child} {how}, and {verdict.text}")
        courses = self._courses_at(verdict)
        watched = f"; its temperature is watched for {courses.lasts_s:.0f} s at the most" if courses is not None else ""
        text = f"process {self._child} {how}; {sentence(controller, verdict)}"
        self.tell(f"{text}{watched}")
        if meter is not None:
            switch_off(meter, 0.0)
        if courses is not None:
            look = temperature_after(controller, courses, verdict.said_s, self._patience_s)
            if look.agrees is False:
                return self._not_confirmed(controller, look.text)
            self.tell(said := "the temperature agrees" if look.agrees else "the temperature did not show either")
            text = f"{text}; {said}"
        self._end_the_run(text, confirmed=True)
        return status

    def _courses_at(self, verdict: Verdict) -> Courses | None:
        """What the child had told of the temperature, where that still holds; None where nothing can be judged."""
        if verdict.text or verdict.said_s - self._courses_s > FRESH_S:  # off late, by its dead man; or told long ago
            return None
        return self._courses

    def _verdict(self, controller: Held) -> Verdict:
        """What was found at once, or else after silence; or all of it, where the port could not be opened at once."""
        if self._at_once is None:
            return switch_off(controller, self._patience_s)
        if self._at_once.confirmed:
            return self._at_once
        return look_once_more(controller, self._at_once, self._patience_s)

    def _not_confirmed(self, controller: Held, text: str = "") -> int:
        """Where the output may be on by this program's doing, somebody goes on trying. text: empty if it is told."""
        if self._busy:
            keep_trying(controller)
        if text:
            self.tell(f"OUTPUT NOT CONFIRMED OFF: {text}. Switch the controller off by hand.")
            self._end_the_run(text, confirmed=False)
        elif self._left is not None:  # the child has said that, and waited for no report
            self._report(self._left.folder)
        return NotConfirmedOff.exit_status

    def _end_the_run(self, text: str, confirmed: bool) -> None:
        """Written into its folder, and that is told last: a disk that does not answer holds up nothing else."""
        if folder := write_end(self._left, text, confirmed):
            self.tell(f"the run, as far as it went, is in {folder}")
            self._report(folder)

    def _report(self, folder: str) -> None:
        """Of a run that had no time for one. Nobody waits for it: the exit status, and a restart, are more urgent."""
        if begin_report(folder) is not None:
            self.tell(f"its report is drawn now, where it has rows enough: {folder}/report.html")
