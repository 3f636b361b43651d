"""The output of a verb: lines for people, a progress line, and JSON with --json."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.command.record_arguments import writable_file
from rig.core.file_writing import write_text
from rig.records.run_folder import plain_json

if TYPE_CHECKING:
    from rig.command.progress import Progress
    from rig.core.streams import PatientLine


class Terminal:
    """Prints lines for people, on stderr if stdout belongs to --json."""

    def __init__(self, json_target: str | None) -> None:
        """Raise Faults if the file of --json cannot be written."""
        self._json = json_target
        if json_target not in (None, "-"):
            writable_file(Path(str(json_target)))
        self._stream = sys.stderr if json_target == "-" else sys.stdout
        self._line: PatientLine | None = None

    def print(self, text: str) -> None:
        """Print a line, in place of the progress line."""
        if self._line is not None:
            self._line.clear()
        print(text, file=self._stream, flush=True)

    def write_json(self, value: Any) -> None:
        """Write the JSON, if --json is given."""
        if self._json == "-":
            sys.stdout.write(plain_json(value) + "\n")
            sys.stdout.flush()
        elif self._json is not None:
            write_text(Path(self._json), plain_json(value) + "\n")

    @contextmanager
    def progress(self, virtual: bool = False) -> Iterator[Progress | None]:
        """Show a line with the progress of an experiment; none if time is simulated and stderr is no terminal."""
        if virtual and not sys.stderr.isatty():
            yield None
            return
        from rig.command.progress import Progress
        from rig.core.streams import PatientLine, TerminalLine

        self._line = PatientLine(TerminalLine(sys.stderr))
        try:
            yield Progress(self._line, virtual)
        finally:
            self._line.clear()
            self._line = None


def to_stderr(text: str) -> None:
    """Print a line on stderr at once."""
    print(text, file=sys.stderr, flush=True)
