"""What the verbs print: lines, progress, and JSON where it is asked for."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig.command.record_arguments import writable_file
from rig.files.run_folder import plain_json


class Voice:
    """Lines for people; on stderr where stdout belongs to --json. Raises Faults where its file cannot be written."""

    def __init__(self, json_target: str | None) -> None:
        self._json = json_target
        if json_target not in (None, "-"):
            writable_file(Path(str(json_target)))
        self._stream = sys.stderr if json_target == "-" else sys.stdout

    def say(self, text: str) -> None:
        print(text, file=self._stream, flush=True)

    def report(self, value: Any) -> None:
        """Write the JSON, if it was asked for."""
        if self._json == "-":
            sys.stdout.write(plain_json(value) + "\n")
            sys.stdout.flush()
        elif self._json is not None:
            Path(self._json).write_text(plain_json(value) + "\n", encoding="utf-8")

    @contextmanager
    def progress(self, virtual: bool = False) -> Iterator[Callable[[str, float, float], None] | None]:
        """A progress bar a phase on a terminal; elsewhere a line for each phase of a minute or more,
        unless time is virtual."""
        if not sys.stderr.isatty() and virtual:
            yield None
            return
        if not sys.stderr.isatty():
            told: list[tuple[str, float]] = []

            def line(phase: str, done_s: float, of_s: float) -> None:
                if of_s >= 60.0 and (phase, of_s) not in told:
                    told.append((phase, of_s))
                    print(f"{phase}: {of_s / 60.0:.1f} min", file=sys.stderr, flush=True)

            yield line
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        with Progress(
            TextColumn("{task.description:<12}"),
            BarColumn(),
            TextColumn("{task.completed:7.1f} of {task.total:.1f} s"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        ) as bars:
            task = bars.add_task("", total=1.0)

            def show(phase: str, done_s: float, of_s: float) -> None:
                bars.update(task, description=phase, completed=done_s, total=max(of_s, 1e-9))

            yield show
