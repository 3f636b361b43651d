"""Whoever reads stdout and stderr may go, or never have been there: a run goes on, and its status is its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.small import write_bench

pytestmark = pytest.mark.skipif(os.name != "posix", reason="descriptors are closed before a program begins")
Begun = Callable[[], None]


def nobody_reads(*descriptors: int) -> Begun:
    """Each is a pipe whose reader has gone."""

    def begin() -> None:
        for descriptor in descriptors:
            reader, writer = os.pipe()
            os.dup2(writer, descriptor)
            os.close(reader)
            os.close(writer)

    return begin


def closed(*descriptors: int) -> Begun:
    """As `>&-` does."""

    def begin() -> None:
        for descriptor in descriptors:
            os.close(descriptor)

    return begin


def short_bench(folder: Path) -> Path:
    return write_bench(folder, target='["start 20 kohm", "hold 1 s"]')


def run(path: Path, begun: Begun) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rig", "run", str(path), "--out", str(path.parent / "run")]
    return subprocess.run(command, capture_output=True, text=True, preexec_fn=begun, timeout=120.0)


@pytest.mark.parametrize(
    "begun",
    [nobody_reads(1, 2), *(pytest.param(closed(*streams), marks=pytest.mark.long) for streams in ((0, 1, 2), (1,)))],
)
def test_a_run_goes_on(tmp_path: Path, begun: Begun) -> None:
    done = run(short_bench(tmp_path), begun)
    assert done.returncode == 0
    assert (tmp_path / "run" / "report.html").exists()


@pytest.mark.long
def test_what_stdout_does_not_take_is_told_on_stderr(tmp_path: Path) -> None:
    done = run(short_bench(tmp_path), nobody_reads(1))
    assert "output off, confirmed by the controller" in done.stderr
    assert f"report: {tmp_path / 'run' / 'report.html'}" in done.stderr


def test_a_fault_keeps_its_status(tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    path.write_text(path.read_text() + "[no_such_table]\n")
    assert run(path, nobody_reads(1, 2)).returncode == 2
