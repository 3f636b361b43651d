"""The guard process: parent of the process that holds the ports; it switches the output off when that one dies.

`guarded(work)` forks. The child does the work; the parent, the guard, forwards INT, TERM, HUP and QUIT and passes the
child's exit status on. If the child ends, of whatever cause, without having reported that the output is confirmed off
and released, the guard opens the controller's port itself and commands it off. Exit status 11 if that is not confirmed,
else 128 + n for a child that died of signal n. After a confirmation the guard goes on reading the temperature if the
child had reported what to expect (`rig.safety.switching_off`): a controller that only claims to be off is not believed,
and that is status 11 as well.

The end is reported on stderr and written into the folder of the run. Nothing but the guard's own end waits for whoever
reads stderr; everything is done by then. If the child has itself reported that the output is not confirmed off (status
11), the guard does not contradict it. In both cases, if the output had been armed, a detached process keeps trying.

A child that has armed the output and completes no control cycle for `silence_s`, or is suspended, is ended: this is the
dead man for instruments without one. One that even SIGKILL does not end waits in the kernel, for a disk that hangs: it
can send nothing any more, and the guard commands the output off beside it. Ctrl-Z is ignored, so that an armed output
cannot be put to sleep.

Neither numpy nor a configuration is imported here, so that the guard stays small: some 15 MB.

If a run on real ports has neither a guard process nor a controller with a dead man of its own, it is refused unless the
user gives --unguarded. The ports are read without the schema, which takes long to load.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import selectors
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.config.toml_file import read_toml
from rig.core.faults import Faults, fault
from rig.core.outcome import NotConfirmedOff
from rig.core.streams import PatientLines
from rig.guard.pipe import UNGUARDED, DeathNotice, Guard, GuardPipe, die_with
from rig.guard.stale_run import begin_report, write_end
from rig.guard.takeover import (
    Held,
    keep_trying,
    look_once_more,
    off_at_once,
    prepare,
    sentence,
    switch_off,
    temperature_after,
)
from rig.safety.signals import CAUGHT
from rig.safety.switching_off import ExpectedCurves, Verdict, curves_from_table

if TYPE_CHECKING:
    from rig.config.configuration import ConfigurationFile

SILENCE_S = 30.0  # longer than any computation with the output on; a controller's own dead man acts sooner
PATIENCE_S = 3.0  # for an adapter that is plugged in again
FRESH_S = 3.0  # expected temperatures come twice a second; later the plate is elsewhere
GRACE_S = 3.0  # from SIGTERM to SIGKILL for a child that hangs


def guarded(work: Callable[[Guard], int], *, silence_s: float = SILENCE_S, patience_s: float = PATIENCE_S) -> int:
    """Do `work` in a child process under guard; return the exit status.

    Call it from the main thread, before threads and large imports. It returns in the guard, and in the child as well
    with the value (or exception) of `work`: nothing but the way out may follow. Without fork `work` is done without a
    guard, with a message.

    silence_s: an armed loop without a cycle for so long is ended. patience_s: for how long opening a port is retried.
    """
    if not hasattr(os, "fork") or threading.current_thread() is not threading.main_thread():
        what = "only the controller's own dead man, if it has one, switches the output off"
        print(f"no guard process here: if this process dies, {what}", file=sys.stderr)
        return work(UNGUARDED)
    sys.stdout.flush()
    sys.stderr.flush()
    reader, writer = os.pipe()
    notice = DeathNotice.if_possible()
    with _Signals() as signals:
        guard_pid = os.getpid()
        child = os.fork()
        if child:
            os.close(writer)
            watch = _Watch(child, reader, signals, notice, silence_s, patience_s)
            try:
                return watch.until_the_end()
            finally:
                watch.report.close(None)
    os.close(reader)
    die_with(guard_pid)
    return work(GuardPipe(writer, guard_pid, notice))


class _Signals:
    """Context in which signals only wake `select`, as bytes in a pipe; Ctrl-Z is ignored, in the child as well."""

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
        """Restore the handlers, in the guard and in the child; in the child Ctrl-Z stays ignored."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup)
        if os.getpid() == self._pid:
            signal.signal(signal.SIGTSTP, self._suspend)
        os.close(self.reader)
        os.close(self.writer)


class _Watch:
    """The guard's loop."""

    def __init__(
        self,
        child: int,
        reader: int,
        signals: _Signals,
        notice: DeathNotice | None,
        silence_s: float,
        patience_s: float,
    ) -> None:
        self._child, self._reader, self._signals, self._notice = child, reader, signals, notice
        self._silence_s, self._patience_s = silence_s, patience_s
        self._held: dict[str, Held] = {}
        self._busy = False
        self._given_up = False
        self._given_up_before = False  # before the last attempt to open the controller's port
        self._heard_s = time.monotonic()
        self._kill_s: float | None = None  # when a child that hangs is killed
        self._killed = False  # it was, and should have died of that
        self._text = b""
        self._at_once: Verdict | None = None
        self._curves: ExpectedCurves | None = None
        self._curves_s = -math.inf  # when they came
        self._folder = ""  # of the run that is being written
        self.report = PatientLines("peltier guard")

    def until_the_end(self) -> int:
        """Wait for the child's end, then switch off what it left on; return the exit status."""
        os.set_blocking(self._reader, False)
        with selectors.DefaultSelector() as selector:
            selector.register(self._reader, selectors.EVENT_READ)
            selector.register(self._signals.reader, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select(self._wait_s()):
                    if key.fd == self._signals.reader:
                        self._take_signals()
                    elif not self._read_messages():
                        selector.unregister(self._reader)
                ended, code = os.waitpid(self._child, os.WNOHANG | os.WUNTRACED)
                if ended and os.WIFSTOPPED(code):
                    self._end_suspended()
                elif ended:
                    break
                self._check_silence()
        self._read_messages()
        os.close(self._reader)
        return self._status(os.waitstatus_to_exitcode(code))

    def _wait_s(self) -> float | None:
        due = [self._kill_s] if self._kill_s is not None else []
        if self._busy and not self._given_up and self._kill_s is None:
            due.append(self._heard_s + self._silence_s)
        return max(min(due) - time.monotonic(), 0.0) if due else None

    def _take_signals(self) -> None:
        """Forward signals; a byte 0 reports the child's death."""
        with contextlib.suppress(BlockingIOError):
            for number in os.read(self._signals.reader, 256):
                if number in CAUGHT:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(self._child, number)
                elif number == 0:
                    self._read_messages()
                    controller = self._held.get("controller")
                    if controller is not None and not self._given_up:
                        self._at_once = off_at_once(controller)

    def _read_messages(self) -> bool:
        """Read the child's messages; False at the end of the pipe."""
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
        if event == "begun" and self._notice is not None:
            self._notice.write_at_death(self._signals.writer)
        elif event == "holds":
            held = Held(**message)  # type: ignore[arg-type]
            self._held[held.role] = held
            if held.role == "controller":
                self._given_up_before, self._given_up = self._given_up, False
            with contextlib.suppress(Exception):  # tried again, and reported, when it is needed
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
            table: Any = message["curves"]
            self._curves = curves_from_table(table) if table is not None else None
            self._curves_s = time.monotonic()
        elif event == "records":
            self._folder = str(message["folder"])
        else:
            self._busy, self._curves = event == "busy", None
            if self._busy:  # armed again: an earlier unconfirmed off was reported, and is over
                self._given_up = False
            self._heard_s = time.monotonic()

    def _check_silence(self) -> None:
        now = time.monotonic()
        if self._kill_s is not None:
            if now >= self._kill_s:
                if self._killed and self._at_once is None:
                    self._switch_off_beside()
                os.kill(self._child, signal.SIGKILL)
                self._killed, self._kill_s = True, now + GRACE_S
        elif self._busy and not self._given_up and now - self._heard_s >= self._silence_s:
            os.kill(self._child, signal.SIGTERM)
            self._kill_s = now + GRACE_S
            self.report(f"process {self._child}: no tick for {self._silence_s:g} s with the output armed; ending it")

    def _switch_off_beside(self) -> None:
        """Command the output off although the child has not died; its lock on the port is not waited for."""
        controller = self._held.get("controller")
        if controller is None:
            return
        self._at_once = off_at_once(controller)
        what = f"process {self._child} does not end, not even of SIGKILL: does a disk hang?"
        if self._at_once is not None and self._at_once.confirmed:
            self.report(f"{what} {sentence(controller, self._at_once)}")
        else:
            why = self._at_once.text if self._at_once is not None else "its port cannot be opened"
            by_hand = f"{controller.port}: {why}. Switch the controller off by hand."
            self.report(f"OUTPUT NOT CONFIRMED OFF: {what} {by_hand}")

    def _end_suspended(self) -> None:
        """End a suspended child that holds an instrument: it controls nothing."""
        if self._held:
            os.kill(self._child, signal.SIGKILL)
            self.report(f"process {self._child} was suspended while it held the controller; ending it")

    def _status(self, code: int) -> int:
        """Return the exit status, after switching the output off unless the child reported it off."""
        status = 128 - code if code < 0 else code
        how = f"died of {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"
        controller, meter = self._held.get("controller"), self._held.get("meter")
        if controller is None:
            if code < 0:
                self.report(f"process {self._child} {how}; it held no controller")
            return status
        if self._given_up or status == NotConfirmedOff.exit_status:  # the child has reported it: nobody contradicts
            if not self._given_up:
                switch_off(controller, self._patience_s)
            return self._not_confirmed(controller)
        verdict = self._verdict(controller)
        if not verdict.confirmed:
            return self._not_confirmed(controller, f"process {self._child} {how}, and {verdict.text}")
        curves = self._curves_for(verdict)
        check = f"; checking its temperature for up to {curves.lasts_s:.0f} s" if curves is not None else ""
        text = f"process {self._child} {how}; {sentence(controller, verdict)}"
        self.report(f"{text}{check}")
        if meter is not None:
            switch_off(meter, 0.0)
        if curves is not None:
            found = temperature_after(controller, curves, verdict.said_s, self._patience_s)
            if found.agrees is False:
                return self._not_confirmed(controller, found.text)
            self.report(result := "the temperature agrees" if found.agrees else "the temperature could not decide")
            text = f"{text}; {result}"
        self._end_run(text, confirmed=True)
        return status

    def _curves_for(self, verdict: Verdict) -> ExpectedCurves | None:
        """Return the child's expected temperatures, if they still hold; None after a late "off" or old curves."""
        if verdict.text or verdict.said_s - self._curves_s > FRESH_S:
            return None
        return self._curves

    def _verdict(self, controller: Held) -> Verdict:
        """Return the verdict of the "off" at the child's death; of a full one if the port could not be opened then."""
        if self._at_once is None:
            return switch_off(controller, self._patience_s)
        if self._at_once.confirmed:
            return self._at_once
        return look_once_more(controller, self._at_once, self._patience_s)

    def _not_confirmed(self, controller: Held, text: str = "") -> int:
        """Report an unconfirmed "off" (text: "" if the child has), and keep trying if this program armed the output."""
        if self._busy:
            keep_trying(controller)
        if text:
            self.report(f"OUTPUT NOT CONFIRMED OFF: {text}. Switch the controller off by hand.")
            self._end_run(text, confirmed=False)
        elif self._folder:  # the child waited for no report
            self._begin_report(self._folder)
        return NotConfirmedOff.exit_status

    def _end_run(self, text: str, confirmed: bool) -> None:
        """Write the end into the run's folder, last of all: a disk that hangs holds up nothing else."""
        if self._folder and write_end(self._folder, text, confirmed):
            self.report(f"what was recorded is in {self._folder}")
            self._begin_report(self._folder)

    def _begin_report(self, folder: str) -> None:
        """Start the report, and wait for nothing: the exit status, and a restart, are more urgent."""
        if begin_report(folder) is not None:
            self.report(f"a report of it is being drawn: {folder}/report.html")


def has_real_ports(configuration: Path) -> bool:
    """Return True for real ports; False for sim:// and for a file that cannot be read, which is reported later."""
    try:
        port = read_toml(configuration)["bench"]["controller"]["port"]
    except (Faults, KeyError, TypeError):
        return False
    return isinstance(port, str) and not port.startswith("sim://")


def guarded_where_needed(configuration: Path, own_process: bool, work: Callable[[Guard], int]) -> int:
    """Do `work` under a guard if the ports are real and this process may fork; return as `guarded` does."""
    if own_process and has_real_ports(configuration):
        return guarded(work)
    return work(UNGUARDED)


def add_unguarded_argument(parser: argparse.ArgumentParser) -> None:
    """Add --unguarded, for the verbs that arm the output."""
    parser.add_argument(
        "--unguarded",
        action="store_true",
        help="run although neither a guard process nor the controller's own dead man would switch the output off",
    )


def require_who_switches_off(file: ConfigurationFile, guard: Guard, unguarded: bool) -> None:
    """Raise Faults for real ports without a guard process (a system without fork) and without a dead man."""
    from rig.drivers.registry import controller_class

    table = file.content.bench.controller
    if guard.guarding or unguarded or table.port.startswith("sim://"):
        return
    try:
        driver = controller_class(table.driver)
    except ValueError:  # reported when the port is opened
        return
    if not driver.has_dead_man:
        raise fault(
            file.path,
            "bench.controller.driver",
            f"{table.driver!r} has no dead man of its own, and this system has no guard process: if the program hangs, "
            "the output stays on; expected another controller, or --unguarded",
        )
