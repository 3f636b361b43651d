"""The command line as tests call it, in this process or in one of its own."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from rig.__main__ import main


def begun(*words: object, **more: Any) -> subprocess.Popen[str]:
    """Begin a verb in a process of its own, whose stdout is read here; more: of Popen."""
    command = [sys.executable, "-m", "rig", *map(str, words)]
    return subprocess.Popen(command, **{"stdout": subprocess.PIPE, "text": True, **more})


class Peltier:
    """Call a verb: (exit status, stdout, stderr). That it compiles is said once a process, by whichever test comes
    first: it is left out."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: object) -> tuple[int, str, str]:
        status = main([str(word) for word in words])
        captured = self._capsys.readouterr()
        lines = captured.err.splitlines(keepends=True)
        return status, captured.out, "".join(line for line in lines if not line.startswith("compiling numerical code"))

    def succeeds(self, *words: object) -> str:
        """Return what a verb that ends with 0 prints on stdout."""
        status, out, err = self(*words)
        assert status == 0, err
        return out

    def quietly(self, *words: object) -> str:
        """Return what a verb that ends with 0 prints on stdout; it says nothing on stderr."""
        status, out, err = self(*words)
        assert (status, err) == (0, "")
        return out

    def fails(self, *words: object, status: int = 2) -> str:
        """Return what a verb that ends with this status says on stderr."""
        found, _, err = self(*words)
        assert found == status, err
        return err
