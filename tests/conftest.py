"""Shared fixtures: the folder of measured records, the command line in this process, a browser.

Tests run side by side, in some processes. So each calculates with one thread.
"""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any, TextIO

import pytest

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

from tests.peltier import Peltier  # noqa: E402 - numpy and numba read these where they are imported

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(scope="session")
def measured() -> Path:
    """The folder of measured records (PELTIER_DATA, by default ../shared/data); skips where it is missing."""
    folder = Path(os.environ.get("PELTIER_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no measured records: {folder} is not there (set PELTIER_DATA)")
    return folder


@pytest.fixture
def peltier(capsys: pytest.CaptureFixture[str]) -> Peltier:
    """The command line in this process."""
    return Peltier(capsys)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One browser for a file of tests, as its event loop runs as long; skips where there is none."""
    playwright_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no chromium is installed (Debian: apt-get install chromium)")
    with playwright_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports whose figures are made and not drawn, which would be half of a short run. For tests that look at other
    things; each figure is drawn where its report is tested."""

    def savefig(self: object, file: TextIO, **settings: object) -> None:
        file.write("<svg></svg>")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", savefig)


class _Here(Executor):
    """Calls what it is given at once, as it would arrive in another process."""

    _processes = None  # as of a pool that has begun none

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **more: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            work, arguments = pickle.loads(pickle.dumps((work, arguments)))
            future.set_result(work(*arguments, **more))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture
def computed_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many cases computed in this process: each other one takes seconds to begin. For tests of what becomes of the
    results; tests/rig/batch are of the processes."""
    monkeypatch.setattr("rig.batch.ProcessPoolExecutor", lambda *settings: _Here())
