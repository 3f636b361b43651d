"""STOP: by mouse, by keyboard alone, by a screen reader's name for it, on a phone, and when the bench is away."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.rig.web.page_bench import PageBench

pytest.importorskip("playwright.sync_api")
from playwright.sync_api import expect

OFF = "output off, confirmed"


@pytest.fixture
def running(open_page: Callable[..., Any], bench: PageBench) -> Any:
    """The page of a bench whose output is on."""
    bench.add_job("film 7")
    page = open_page()
    expect(page.get_by_role("status").filter(has_text="output")).to_have_text("output on")
    expect(page.locator("#state-word")).to_have_text("Running")
    return page


def assert_off(page: Any, bench: PageBench, stops: int = 1) -> None:
    expect(page.locator("#output")).to_have_text(OFF)
    expect(page.locator("#state-word")).to_have_text("Stopped")
    assert len(bench.stops) == stops


def test_by_click_by_keyboard_alone_and_by_its_keys(running: Any, bench: PageBench) -> None:
    button = running.get_by_role("button", name="STOP", exact=True)
    running.keyboard.press("Tab")
    expect(button).to_be_focused()  # the first thing that Tab reaches
    ways = [
        lambda: running.keyboard.press("Enter"),
        lambda: running.keyboard.press("Space"),
        lambda: running.keyboard.press("Escape"),
        lambda: running.keyboard.press("Shift+S"),
        button.click,
    ]
    for count, press in enumerate(ways, 1):
        press()
        assert_off(running, bench, count)
        bench.clear()
        bench.add_job("again")
        expect(running.locator("#output")).to_have_text("output on")
    running.evaluate("scrollTo(0, 100000)")
    expect(button).to_be_in_viewport(ratio=1)


def test_a_press_is_sent_while_an_earlier_one_waits(running: Any, bench: PageBench) -> None:
    button = running.get_by_role("button", name="STOP", exact=True)
    bench.answers_stop_after_s = 3.0
    button.click()
    assert_off(running, bench)
    said = running.get_by_role("alert").filter(has_text="has not answered yet")
    expect(said).to_be_visible()
    bench.answers_stop_after_s = 0.0
    bench.clear()
    bench.add_job("again")
    expect(running.locator("#output")).to_have_text("output on")
    button.click()
    assert_off(running, bench, 2)
    expect(said).to_be_hidden()
    expect(button).not_to_have_attribute("data-busy", "")


def test_what_a_screen_reader_is_told_and_what_keys_do_in_a_field(running: Any, bench: PageBench) -> None:
    button = running.get_by_role("button", name="STOP", exact=True)
    expect(button).to_have_attribute("aria-keyshortcuts", "Escape Shift+S")
    expect(button).to_have_accessible_description("STOP: Esc or Shift+S")
    told = running.locator("#top").aria_snapshot()
    assert told.splitlines()[1] == '  - button "STOP"'
    assert "- status: output on" in told
    expect(running.locator("#output")).to_have_attribute("aria-live", "polite")
    button.press("Space")
    assert_off(running, bench)
    assert f"- status: {OFF}" in running.locator("#top").aria_snapshot()
    running.locator("#text-summary").click()
    running.locator("#text").press_sequentially("S")
    running.keyboard.press("Escape")  # leaves the field: typing is not stopping
    expect(running.locator("#text")).not_to_be_focused()
    assert len(bench.stops) == 1
    running.keyboard.press("Escape")
    assert_off(running, bench, 2)


@pytest.mark.parametrize("bench", [{"stop_port": 9}], indirect=True)  # where nothing listens: it is answered here
def test_it_goes_to_stops_own_listener_too(open_page: Callable[..., Any], bench: PageBench) -> None:
    bench.add_job("film 7")
    page = open_page()
    expect(page.locator("#output")).to_have_text("output on")
    presses: list[dict[str, str]] = []

    def answer(route: Any) -> None:
        if route.request.method == "POST":
            presses.append(route.request.post_data_json)
            bench.commands.stop("the page")
        allowed = {"Access-Control-Allow-Origin": "*", "Access-Control-Allow-Headers": "*"}
        route.fulfill(json={"off": True, "confirmed": True, "took_s": 0.01}, headers=allowed)

    page.route("http://127.0.0.1:9/api/stop", answer)
    page.route(f"{bench.url}api/stop", lambda route: presses.append(route.request.post_data_json))  # never answers
    page.get_by_role("button", name="STOP", exact=True).click()
    expect(page.locator("#output")).to_have_text(OFF)
    expect(page.locator("#stop")).not_to_have_attribute("data-busy", "")
    expect(page.locator("#stop-said")).to_be_hidden()
    assert len(presses) == 2
    assert presses[0]["press"] == presses[1]["press"] != ""


def test_not_confirmed_is_said_loudly_and_it_insists_while_the_bench_is_away(running: Any, bench: PageBench) -> None:
    running.route("**/api/stop", lambda route: route.fulfill(json={"off": False, "confirmed": False, "took_s": 1.0}))
    running.get_by_role("button", name="STOP", exact=True).click()
    expect(running.get_by_role("alert").filter(has_text="NOT CONFIRMED")).to_be_visible()
    running.unroute("**/api/stop")
    running.route("**/api/stop", lambda route: route.abort())
    running.get_by_role("button", name="STOP", exact=True).click()
    expect(running.get_by_role("alert").filter(has_text="STOP did not reach the bench")).to_be_visible()
    assert not bench.stops
    running.unroute("**/api/stop")
    assert_off(running, bench)
    expect(running.locator("#stop-said")).to_be_hidden()


def test_on_a_phone(open_page: Callable[..., Any], bench: PageBench) -> None:
    for count, (width, height) in enumerate([(360, 740), (740, 360)], 1):
        taps_stop(open_page(width, height, has_touch=True, is_mobile=True), bench, height, count)
        bench.clear()


def taps_stop(page: Any, bench: PageBench, height: int, count: int) -> None:
    """STOP is under the thumb wherever the page is scrolled to, and stops."""
    expect(page.locator("#tile-temperature .number")).not_to_have_text("–")
    page.locator("#text-summary").click()
    wide = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide[0] <= wide[1]
    button = page.get_by_role("button", name="STOP", exact=True)
    for place in (0, 700, 100_000):
        page.evaluate("y => scrollTo(0, y)", place)
        expect(button).to_be_in_viewport(ratio=1)
    box = button.bounding_box()
    assert box["height"] >= 60
    assert box["y"] + box["height"] / 2 > height / 2, "not under the thumb"
    button.tap()
    assert_off(page, bench, count)
