"""What `peltier run` and `peltier calibrate` do, on a bench that is open already: another owner of the ports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rig.bench.assembly import Bench
from rig.config.configuration import ConfigurationFile
from rig.control.tick import Tick
from rig.experiment.calibration import Calibration
from rig.experiment.expected import Phases, expected_calibration, expected_run
from rig.experiment.session import Result, Session, calibrate, run_on
from rig.experiment.wanted import wanted
from rig.records.run_folder import RunFolder, prepared_folder
from rig.report.run import write_live_report
from rig.safety.signals import SignalStop


class Watcher:
    """Told of a job's runs: when a loop begins, its phases and ticks, and when the output is off again."""

    def began(self) -> None:
        """A loop has the bench from now on."""

    def expect(self, phases: Phases) -> None:
        """The phases to come, each with its seconds."""

    def phase(self, name: str, duration_s: float) -> None:
        """A phase begins, of so many seconds."""

    def tick(self, tick: Tick) -> None:
        """A control cycle was completed."""

    def ended(self, confirmed: bool | None, ticks: Mapping[str, Any]) -> None:
        """The loop is over and the output was commanded off. ticks: how punctual it was (`rig.control.loop.Ticks`)."""


def run_watched(
    bench: Bench, file: ConfigurationFile, path: Path, say: Callable[[str], None], watcher: Watcher
) -> Result:
    """The experiment that a configuration asks for, into a folder. Raises Faults, RigError, Outcome."""
    target, model = wanted(file, say)
    watcher.expect(expected_run(file.content, target, model))
    with prepared_folder(path):
        return run_on(_watched(bench, file, say, watcher), path, target, model)


def calibrate_watched(
    bench: Bench, file: ConfigurationFile, path: Path, say: Callable[[str], None], watcher: Watcher
) -> Calibration:
    """The calibration that a configuration asks for, into a folder. Raises as `run_watched`."""
    watcher.expect(expected_calibration(file.content))
    with prepared_folder(path):
        return calibrate(_watched(bench, file, say, watcher), path)


def _watched(bench: Bench, file: ConfigurationFile, say: Callable[[str], None], watcher: Watcher) -> Session:
    """A session whose every run tells the watcher."""

    class Watched(RunFolder):
        def __init__(self, path: Path, start: dict[str, Any], configuration_text: str, columns: list[str]) -> None:
            super().__init__(path, start, configuration_text, columns)
            try:
                watcher.began()
            except BaseException:  # a job that was ended without its thread
                self.abandon()
                raise

        def event(self, time_s: float, kind: str, text: str, **more: Any) -> None:
            super().event(time_s, kind, text, **more)
            if kind == "phase":
                watcher.phase(text, float(more.get("duration_s", 0.0)))

        def stop(self, reason: str, **more: Any) -> None:
            watcher.ended(more.get("output_off_confirmed"), more.get("ticks", {}))
            super().stop(reason, **more)

    return Session(bench, file, SignalStop(), say, None, watcher.tick, Watched, write_live_report)
