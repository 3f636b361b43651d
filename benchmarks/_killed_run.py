"""A real `peltier run` on pseudo-terminals, whose port-holding process is killed; for benchmark and test alike.

The emulators run in a thread of this process and write down when an off command's bytes arrive, and when no current
flows any more at the instrument.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks._harness import ROOT
from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.ports.open import holder
from rig.ports.pseudo_terminal import PseudoTerminals

OFF = {"meerstetter": b"VS07DA0100000000", "te_technology": b"2d00000000", "srs_ldc500": b"TEON 0"}
CURRENT = 'kind = "current_profile"\ntarget = ["start 0.9 A", "hold 600 s"]\n'
HOLD = 'kind = "hold"\nlaw = "instrument_pid"\ntarget = ["start 45 degC", "hold 600 s"]\n'

BENCH = """
[bench.controller]
driver = "{driver}"
port = "{controller}"
[bench.meter]
driver = "keithley2000"
port = "{meter}"
nplc = 0.1
[limits]
temperature_degC = [10, 95]
current_A = 4.0
polarity_share = {polarity_share}
[experiment]
period_s = {period}
{experiment}
[simulation]
first_degC = 30.0
"""


class Witness:
    """An emulated controller that says when it was told to switch off, and when no current flowed any more."""

    def __init__(self, instrument: Any, driver: str) -> None:
        self._instrument, self._marker = instrument, OFF[driver]
        self._plant = instrument._plant
        self._heard = b""
        self.told_s: list[float] = []
        self.on = False
        self.off_s = 0.0

    def receive(self, data: bytes, time_s: float) -> None:
        self._heard = (self._heard + data)[-64:]
        if self._marker in self._heard:
            self._heard = b""
            self.told_s.append(time.monotonic())
        self._instrument.receive(data, time_s)
        self._look()

    def transmit(self, time_s: float) -> bytes:
        sent: bytes = self._instrument.transmit(time_s)
        self._look()
        return sent

    def next_transmit_s(self) -> float | None:
        due: float | None = self._instrument.next_transmit_s()
        return due

    def _look(self) -> None:
        on = self._plant.current_A != 0.0
        if self.on and not on:
            self.off_s = time.monotonic()
        self.on = on


@dataclass(frozen=True)
class Killed:
    """One kill: when, when the off command arrived and no current flowed, the exit status, what was said."""

    told_after_s: float
    off_after_s: float
    status: int
    err: str
    off_at_the_end: bool


def memory_kB(pid: int) -> tuple[int, int]:
    """Resident memory of a process, and its part that it shares with no other."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    lines = {line.split(":")[0]: int(line.split()[1]) for line in text.splitlines()[1:] if "kB" in line}
    return lines["Rss"], lines["Private_Clean"] + lines["Private_Dirty"]


class KilledRuns:
    """The instruments of a driver on pseudo-terminals; context. Each `kill` is a run of its own.

    wrapped: makes another controller of the emulated one, such as one that does not obey. polarity_share: of the first
    pulse, none by default: the output's coming on is then the run's own.
    """

    def __init__(
        self, folder: Path, driver: str, wrapped: Callable[[Any], Any] | None = None, polarity_share: float = 0.0
    ) -> None:
        self._folder, self._driver, self._polarity_share = folder, driver, polarity_share
        self._write("/dev/null", "/dev/null")
        instruments = {role: i for role, _, i in emulated_instruments(read_configuration(self.path), 0.0)}
        controller = instruments["controller"] if wrapped is None else wrapped(instruments["controller"])
        self.witness = Witness(controller, driver)
        instruments["controller"] = self.witness
        self.terminals = PseudoTerminals(instruments)
        self.guard_kB = (0, 0)
        self._runs = 0
        self._started: list[subprocess.Popen[str]] = []

    def __enter__(self) -> KilledRuns:
        self.terminals.start()
        self._write(self.terminals.paths["controller"], self.terminals.paths["meter"])
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._started:  # those that a failing test has left
            if process.poll() is None:
                process.terminate()
                process.communicate()
        self.terminals.stop()

    @property
    def path(self) -> Path:
        return self._folder / "bench.toml"

    @property
    def port(self) -> str:
        return self.terminals.paths["controller"]

    def start(self) -> subprocess.Popen[str]:
        """A run with its output on; a busy computer's emulator may answer too late for one, hence a second trial."""
        try:
            return self._start()
        except RuntimeError:
            return self._start()

    def _start(self) -> subprocess.Popen[str]:
        self._runs += 1
        process = subprocess.Popen(
            [sys.executable, "-m", "rig", "run", str(self.path), "--out", str(self._folder / f"run{self._runs}")],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._started = [process]
        until_s = time.monotonic() + 120.0
        while not self.witness.on:
            if process.poll() is not None or time.monotonic() > until_s:
                process.kill()
                raise RuntimeError(f"the run did not come up: {process.communicate()[1]}")
            time.sleep(0.005)
        return process

    def kill(self, after_s: float, number: int = signal.SIGKILL) -> Killed:
        """Start a run, kill the process that holds the port so long after its output came on, and see it off."""
        process = self.start()
        pid, _ = holder(self.port)
        if pid is None or pid == process.pid:
            raise RuntimeError(f"the port is held by {pid}, the guard is {process.pid}")
        self.guard_kB = memory_kB(process.pid)
        time.sleep(after_s)
        self.witness.told_s.clear()
        self.witness.off_s = 0.0
        killed_s = time.monotonic()
        os.kill(pid, number)
        _, err = process.communicate(timeout=60.0)
        told = [t for t in self.witness.told_s if t >= killed_s]
        return Killed(
            told_after_s=told[0] - killed_s if told else float("inf"),
            off_after_s=self.witness.off_s - killed_s if self.witness.off_s else float("inf"),
            status=process.returncode,
            err=err,
            off_at_the_end=not self.witness.on,
        )

    def _write(self, controller: str, meter: str) -> None:
        experiment, period = (HOLD, 0.5) if self._driver == "te_technology" else (CURRENT, 0.05)
        if self._driver == "srs_ldc500":
            period = 0.2
        text = BENCH.format(
            driver=self._driver,
            controller=controller,
            meter=meter,
            period=period,
            experiment=experiment,
            polarity_share=self._polarity_share,
        )
        self.path.write_text(text, encoding="utf-8")
