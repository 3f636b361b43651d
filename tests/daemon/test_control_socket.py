"""The daemon's socket: one holder of a name, from before it answers until it has ended."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

import pytest

from rig.core.errors import PortHeld
from rig.daemon.control_socket import ControlSocket


def test_a_daemon_that_does_not_answer_yet_keeps_its_socket(tmp_path: Path) -> None:
    """While it switches the output off and checks a large history, another one is started by mistake."""
    path = tmp_path / "bench.sock"
    first = ControlSocket(path)
    with pytest.raises(PortHeld, match=f"'bench'.*process {os.getpid()}"):
        ControlSocket(path)
    assert path.is_socket()
    first.close()
    assert not path.exists()
    ControlSocket(path).close()


def test_what_a_killed_daemon_left_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "bench.sock"
    killed = ControlSocket(path)
    os.close(killed._name_lock)  # as the system does
    second = ControlSocket(path)
    assert path.is_socket()
    second.close()
    killed._listener.close()


def test_a_place_without_locks_is_not_told_as_one_that_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", none)
    with pytest.raises(OSError, match="No locks available"):
        ControlSocket(tmp_path / "bench.sock")
