"""The overview: each bench as it is, STOP for each, a bench that is silent, and who may ask."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from rig.core.faults import Faults
from rig.overview import read_overview
from tests.page.overviews import Overview, overviewing, silent, written
from tests.rig.daemon.benches import SERVE, running, write_current
from tests.rig.web.page_bench import PageBench, served

TOKEN, OTHER = "t" * 20, "u" * 20


class Lab(NamedTuple):
    overview: Overview
    left: PageBench
    right: PageBench
    path: Path


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    """Two benches, one with a token, one that never answers, one that is not there."""
    with ExitStack() as stack:
        left = stack.enter_context(served(tmp_path / "left", TOKEN))
        right = stack.enter_context(served(tmp_path / "right"))
        nowhere = "http://127.0.0.1:9"
        benches = {"left": left.url, "silent": stack.enter_context(silent()), "gone": nowhere}
        path = written(tmp_path, {**benches, "right": right.url}, {"left": TOKEN})
        overview = stack.enter_context(overviewing(path))
        overview.until("left", lambda bench: bench["trouble"] is None)
        overview.until("right", lambda bench: bench["trouble"] is None)
        yield Lab(overview, left, right, path)


def test_each_bench_is_told_as_it_is_and_a_silent_one_holds_up_none(lab: Lab) -> None:
    lab.right.trip_now()
    tripped = lab.overview.until("right", lambda bench: bench["state"]["state"] == "tripped")
    assert tripped["state"]["trip"]["cause"] == "over_temperature"
    left = lab.overview.bench("left")
    assert left["state"]["state"] == "idle"
    assert left["state"]["reading"]["resistance_ohm"] > 0.0
    silent_one = lab.overview.until("silent", lambda bench: "no answer" in (bench["trouble"] or ""))
    assert (silent_one["state"], silent_one["silent_s"]) == (None, None)
    assert "refused" in lab.overview.until("gone", lambda bench: bench["trouble"] != "not asked yet")["trouble"]


def test_a_bench_that_ends_is_told_with_the_last_that_was_known(lab: Lab) -> None:
    lab.right.close()
    gone = lab.overview.until("right", lambda bench: bench["trouble"] is not None)
    assert gone["state"]["state"] == "idle"
    assert gone["silent_s"] > 0.0
    assert lab.overview.bench("left")["trouble"] is None


def test_stop_reaches_the_bench_that_is_meant_and_no_other(lab: Lab) -> None:
    for server in (lab.left, lab.right):
        server.add_job("film")
    status, answer = lab.overview.ask("POST", "/api/stop", {"bench": "left", "press": "one"})
    assert (status, answer["confirmed"]) == (200, True)
    assert len(lab.left.stops) == 1
    assert not lab.right.stops
    assert lab.overview.ask("POST", "/api/stop", {"bench": "middle"})[0] == 404
    status, answer = lab.overview.ask("POST", "/api/stop", {"bench": "gone"})
    assert (status, "does not answer" in answer["faults"][0]) == (502, True)


def test_who_may_ask(lab: Lab, tmp_path: Path) -> None:
    stop = {"bench": "left"}
    assert lab.overview.ask("POST", "/api/stop", stop, Origin="http://elsewhere.example")[0] == 403
    assert lab.overview.ask("GET", "/api/state", Host="elsewhere.example")[0] == 403
    assert lab.overview.ask("POST", "/api/stop", stop, **{"Content-Type": "text/plain"})[0] == 415
    assert lab.overview.ask("POST", "/api/stop", stop, **{"X-Peltier": "0"})[0] == 403
    assert not lab.left.stops
    folder = tmp_path / "with_token"
    folder.mkdir()
    path = written(folder, {"left": lab.left.url}, {"left": TOKEN}, f'token = "{OTHER}"')
    with overviewing(path) as closed:
        for headers in ({}, {"Authorization": f"Bearer {TOKEN}"}):
            assert closed.ask("GET", "/api/state", **headers)[0] == 401
            assert closed.ask("POST", "/api/stop", stop, **headers)[0] == 401
        assert not lab.left.stops
        status, known = closed.ask("GET", "/api/state", Authorization=f"Bearer {OTHER}")
        assert status == 200
        assert TOKEN not in str(known)
        assert closed.ask("POST", "/api/stop", stop, Authorization=f"Bearer {OTHER}")[0] == 200
    assert len(lab.left.stops) == 1


def test_a_wrong_token_is_told(lab: Lab, tmp_path: Path) -> None:
    folder = tmp_path / "wrong"
    folder.mkdir()
    with overviewing(written(folder, {"left": lab.left.url}, {"left": OTHER})) as wrong:
        wrong.until("left", lambda bench: "token" in (bench["trouble"] or ""))


def test_a_real_bench_is_stopped_by_its_page(tmp_path: Path) -> None:
    with ExitStack() as stack:
        path = write_current(tmp_path, more=f'{SERVE}token = "{TOKEN}"\n')
        bench = stack.enter_context(running(path, web=True))
        overview = stack.enter_context(overviewing(written(tmp_path, {"real": bench.url}, {"real": TOKEN})))
        overview.until("real", lambda found: (found["state"] or {}).get("state") == "idle")
        bench.commands.submit(bench.file, "a run", None, None)
        overview.until("real", lambda found: found["state"]["state"] == "running")
        status, answer = overview.ask("POST", "/api/stop", {"bench": "real"})
        assert (status, answer["confirmed"]) == (200, True)
        assert bench.state()["state"] == "stopped"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "bench: missing"),
        ('[[bench]]\nname = "a"\naddress = "127.0.0.1:8765"', "http://10.0.0.7:8765"),
        ('[[bench]]\nname = "a"\naddress = "http://h:99999"', "http://10.0.0.7:8765"),
        ('[[bench]]\nname = "a"\naddress = "http://h"\ntoken = "short"', "token"),
        ('[[bench]]\nname = "a"\naddress = "http://h"\n' * 2, "expected each name once"),
        ('[overview]\naddress = "0.0.0.0"\n[[bench]]\nname = "a"\naddress = "http://h"', "overview.token: missing"),
        ('[[bench]]\nname = "a"\naddress = "http://h"\nadress = 1', "adress"),
    ],
)
def test_a_wrong_configuration_is_told_in_a_line(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "overview.toml"
    path.write_text(text)
    with pytest.raises(Faults) as told:
        read_overview(path)
    assert any(line in one for one in told.value.lines), told.value.lines


@pytest.fixture
def page(browser: Any, lab: Lab) -> Iterator[Any]:
    """The overview in a browser; a script's error or a breach of its policy fails the test."""
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(20_000)
    one = context.new_page()
    one.on("pageerror", lambda fault: complaints.append(f"error: {fault}"))
    one.on("console", lambda said: "Content Security" in said.text and complaints.append(said.text))
    one.on("request", lambda asked: asked.url.startswith(lab.overview.url) or complaints.append(f"asks {asked.url}"))
    one.goto(lab.overview.url)
    yield one
    context.close()
    assert not complaints


def test_a_bench_whose_instruments_are_gone_shows_no_reading_as_new(page: Any, lab: Lab) -> None:
    """It answers, and so was heard of just now; its latest reading is as old as its instruments are gone."""
    from playwright.sync_api import expect

    left, bench = page.locator('[data-bench="left"]'), lab.left
    expect(left.locator(".state")).to_have_text("Idle", timeout=20_000)
    bench.frozen = True
    bench.commands.recent[-1]["time_s"] -= 60.0
    bench.shown = {"warnings": ["offline: /dev/ttyUSB0: gone"]}
    bench.trip_now("not_confirmed_off", "the controller is gone")
    expect(left.locator(".state")).to_have_text("Tripped", timeout=20_000)
    expect(left.locator(".heard")).to_contain_text("its reading", timeout=20_000)
    expect(left.locator(".about")).to_contain_text("Switch the controller off by hand.")
    assert float(left.locator(".values dd").first.evaluate("node => getComputedStyle(node).opacity")) < 0.6


def test_the_page_shows_and_stops(page: Any, lab: Lab) -> None:
    from playwright.sync_api import expect

    left = page.locator('[data-bench="left"]')
    expect(left.locator(".state")).to_have_text("Idle", timeout=20_000)
    expect(page.locator('[data-bench="silent"] .state')).to_have_text("No answer", timeout=20_000)
    lab.left.add_job("film 7")
    expect(left.locator(".output")).to_have_text("output on", timeout=20_000)
    expect(left.locator(".about")).to_contain_text("film 7")
    page.get_by_role("button", name="STOP left", exact=True).click()
    expect(left.locator(".state")).to_have_text("Stopped", timeout=20_000)
    expect(left.locator(".output")).to_have_text("output off, confirmed")
    assert len(lab.left.stops) == 1
    assert not lab.right.stops
    lab.right.close()
    expect(page.locator('[data-bench="right"] .state')).to_have_text("No answer", timeout=20_000)
    expect(page.locator('[data-bench="right"] .output')).to_have_text("output not known")
    page.get_by_role("button", name="STOP right", exact=True).click()
    expect(page.locator('[data-bench="right"] .said')).to_contain_text("STOP did not reach the bench", timeout=20_000)
