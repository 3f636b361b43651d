"""The daemon behind the page's tests, with its page: simulated instruments, with faults at one's fingertips."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.config.configuration import read_configuration
from rig.core.outcome import Tripped
from rig.daemon.command_queue import Job
from rig.daemon.output_lock import Off
from tests.rig.daemon.benches import SERVE, RunningBench, until, write_current


class PageBench(RunningBench):
    """A bench with its page.

    shown: put over the state that everybody gets. stops: when STOP arrived. answers_stop_after_s: once it is off.
    frozen: no reading comes any more.
    """

    def __init__(self, folder: Path, token: str | None = None, stop_port: int | None = None, port: int = 0) -> None:
        serve = SERVE.replace("port = 0", f"port = {port}") + (f'token = "{token}"\n' if token else "")
        super().__init__(write_current(folder, '["start 0 A", "hold 600 s"]', "demo", serve), folder / "bench.sock")
        self.folder = folder
        self.shown: dict[str, Any] = {}
        self.stops: list[float] = []
        self.answers_stop_after_s = 0.0
        self.frozen = self._closed = False
        commands = self.commands
        commands.stop_port = stop_port
        commands.model = folder / "model.toml"
        state, stop, row = commands.state, commands.stop, commands.row

        def counted(by: str) -> Off:
            self.stops.append(time.time())
            off = stop(by)
            time.sleep(self.answers_stop_after_s)
            return off

        commands.state = lambda: {**state(), **self.shown}  # type: ignore[method-assign]
        commands.stop = counted  # type: ignore[method-assign]
        commands.row = lambda one: None if self.frozen else row(one)  # type: ignore[method-assign]
        until(lambda: commands.online and commands.recent, "the bench")
        commands.memory_since_s = commands.label_s() - 60.0
        self.serve()

    @property
    def port(self) -> int:
        return int(self.url.rstrip("/").rpartition(":")[2])

    def add_job(self, name: str) -> Job:
        """Into the queue; where nothing runs its output is on afterwards."""
        alone = self.commands.is_idle()
        job = self.commands.submit(read_configuration(self.folder / "demo.toml"), name)
        if alone:
            until(lambda: self.state()["output"] == "on", "the output")
        return job

    def trip_now(self, cause: str = "over_temperature", text: str = "95.3 degC is above the limit of 95 degC") -> None:
        """As if a limit were passed, by the job where one runs."""
        if self.commands.queue.running is None:
            self.commands.trip(cause, text)
        else:
            self.commands.output_lock.stop(Tripped(cause, text, 0.0))
        until(lambda: self.state()["trip"], "the trip")

    def clear(self) -> None:
        """What latched is cleared; the queue goes on."""
        until(lambda: self.commands.queue.running is None, "the job's end")
        assert self.commands.reset("a test")

    def rows(self, times_s: list[float], degC: float, ohm: float = 1e4) -> None:
        """Rows of the past, by its history."""
        row = {"temperature_degC": degC, "resistance_ohm": ohm, "current_A": 0.0, "quality": "good", "phase": "idle"}
        self.commands.writer.do(lambda store: store.add({"time_s": time_s, **row} for time_s in times_s))
        assert self.commands.writer.settle()

    def close(self) -> None:
        """End, once."""
        if not self._closed:
            self._closed = True
            super().close()


@contextlib.contextmanager
def served(folder: Path, token: str | None = None, stop_port: int | None = None, port: int = 0) -> Iterator[PageBench]:
    """A bench with its page in a folder (the same one again, at its port: that bench, begun anew)."""
    folder.mkdir(exist_ok=True)
    bench = PageBench(folder, token, stop_port, port)
    try:
        yield bench
    finally:
        bench.close()
