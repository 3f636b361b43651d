"""The page of a bench in a real browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.rig.web.page_bench import PageBench, served


@pytest.fixture
def bench(tmp_path: Path, request: pytest.FixtureRequest, undrawn: None) -> Iterator[PageBench]:
    """A bench that idles, with its page. Parameter: more words for `served`."""
    with served(tmp_path / "bench", **getattr(request, "param", {})) as one:
        yield one


@pytest.fixture
def open_page(browser: Any, bench: PageBench) -> Iterator[Callable[..., Any]]:
    """Open the page; a script's error or a breach of the page's policy fails the test, any request off it too."""
    from playwright.sync_api import expect

    expect.set_options(timeout=60_000)  # of patience on a busy computer
    contexts, complaints = [], []

    def open_one(width: int = 1280, height: int = 900, **settings: Any) -> Any:
        context = browser.new_context(viewport={"width": width, "height": height}, **settings)
        context.set_default_timeout(60_000)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda fault: complaints.append(f"error: {fault}"))
        page.on("console", lambda said: "Content Security" in said.text and complaints.append(said.text))
        ours = (bench.url, f"http://127.0.0.1:{bench.commands.stop_port}/api/stop")
        page.on("request", lambda asked: asked.url.startswith(ours) or complaints.append(f"asks {asked.url}"))
        page.goto(bench.url)
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert not complaints
