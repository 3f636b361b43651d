"""What the verbs print: lines, progress, and JSON with --json."""

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
    from rig.core.terminal_line import PatientLine


class Voice:
    """Lines for people; on stderr where stdout belongs to --json. Raises Faults where its file cannot be written."""

    def __init__(self, json_target: str | None) -> None:
        self._json = json_target
        if json_target not in (None, "-"):
            writable_file(Path(str(json_target)))
        self._stream = sys.stderr if json_target == "-" else sys.stdout
        self._line: PatientLine | None = None

    def say(self, text: str) -> None:
        if self._line is not None:
            self._line.clear()
        print(text, file=self._stream, flush=True)

    def report(self, value: Any) -> None:
        """Write the JSON, if --json is given."""
        if self._json == "-":
            sys.stdout.write(plain_json(value) + "\n")
            sys.stdout.flush()
        elif self._json is not None:
            write_text(Path(self._json), plain_json(value) + "\n")

    @contextmanager
    def progress(self, virtual: bool = False) -> Iterator[Progress | None]:
        """A line that shows how far an experiment is; none where simulated time runs and nobody watches."""
        if virtual and not sys.stderr.isatty():
            yield None
            return
        from rig.command.progress import Progress
        from rig.core.terminal_line import PatientLine, TerminalLine

        self._line = PatientLine(TerminalLine(sys.stderr))
        try:
            yield Progress(self._line, virtual)
        finally:
            self._line.clear()
            self._line = None
