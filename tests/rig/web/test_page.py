"""The page in a real browser: live, tripped, stale, away and back, runs and their start, names that look like HTML."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

import pytest

from tests.rig.daemon.benches import until
from tests.rig.web.page_bench import PageBench, served

pytest.importorskip("playwright.sync_api")
from playwright.sync_api import expect

Open = Callable[..., Any]
NASTY = "<img src=x onerror=\"document.body.dataset.pwned='1'\"><script>document.body.dataset.pwned='2'</script>"


def test_readings_and_the_loop_are_live(open_page: Open, bench: PageBench) -> None:
    until(lambda: bench.ask("GET", "/api/loop")[0] == 200, "the loop, whose film is compiled once")
    page = open_page()
    number = page.locator("#tile-temperature .number")
    expect(number).not_to_have_text("–")
    before = number.text_content()
    expect(number).not_to_have_text(before)
    expect(page.locator("#tile-resistance .unit")).to_have_text("kΩ")
    expect(page.locator("#link")).to_have_attribute("data-link", "live")
    expect(page.locator("#loop-memory")).to_contain_text(re.compile(r"[\d.]+ k?Ω to [\d.]+ k?Ω"))
    expect(page.locator("#loop-plot path.rising")).to_have_count(1)
    expect(page.locator("#loop-plot path.reach")).to_have_count(1)
    gaps = {"count": 2, "longest_s": 340.0, "total_s": 352.0}
    bench.shown = {"drive_unit": "of full drive", "gaps": gaps}  # of a heater
    page.reload()
    expect(page.locator("#tile-current h2")).to_contain_text("Drive")
    expect(page.locator("#tile-current .unit")).to_have_text("of full")
    expect(page.locator("#plot-current figcaption")).to_have_text("Drive, of full")
    expect(page.locator("#facts")).to_contain_text("2, the longest 5 min 40 s")


def test_stale_readings_are_named_so(open_page: Open, bench: PageBench) -> None:
    page = open_page()
    expect(page.locator("#tile-temperature .number")).not_to_have_text("–")
    page.clock.install()
    bench.frozen = True
    page.wait_for_timeout(200)
    page.clock.fast_forward(8000)
    expect(page.locator("#tile-temperature .chip")).to_contain_text("stale")
    assert float(page.locator("#tile-current .value").evaluate("node => getComputedStyle(node).opacity")) < 0.6
    expect(page.locator("#link-word")).to_contain_text("connected, but the reading is")
    bench.frozen = False
    page.clock.run_for(1500)
    expect(page.locator("#tile-temperature .chip")).to_be_hidden()


def test_a_trip_is_shown_and_reset_with_a_reason(open_page: Open, bench: PageBench) -> None:
    bench.add_job("film 7")
    page = open_page()
    expect(page.locator("#state-word")).to_have_text("Running")
    bench.trip_now()
    expect(page.locator("#state-word")).to_have_text("Tripped")
    expect(page.get_by_role("alert").filter(has_text="Tripped: over temperature")).to_be_visible()
    expect(page.locator("#latch-text")).to_have_text("95.3 degC is above the limit of 95 degC")
    expect(page.locator("#state-icon use")).to_have_attribute("href", re.compile("#tripped$"))
    expect(page).to_have_title(re.compile("^! Tripped"))
    expect(page.locator("#output")).to_have_text("output off, confirmed")
    page.get_by_role("button", name="Reset").click()
    expect(page.locator("#reset-said")).to_have_text("a reset needs a reason")
    assert bench.state()["state"] == "tripped"
    page.get_by_label("Reason for the reset").fill("the fan was unplugged")
    page.get_by_role("button", name="Reset").click()
    expect(page.locator("#state-word")).to_have_text("Idle")
    expect(page.locator("#latch")).to_be_hidden()
    assert any(line.endswith("reset: the fan was unplugged") for line in bench.logged)
    bench.trip_now("not_confirmed_off", "the controller is gone")  # says what to do first
    expect(page.locator("#latch-text")).to_have_text("Switch the controller off by hand. the controller is gone")


def test_runs_are_started_queued_removed_and_ended(open_page: Open, bench: PageBench) -> None:
    page = open_page()
    page.get_by_label("Configuration", exact=True).select_option("demo")
    page.get_by_role("button", name="Start the run").click()
    expect(page.locator("#state-word")).to_have_text("Running")
    expect(page.locator("#job-line")).to_contain_text("demo")
    page.get_by_role("button", name="Add to the queue").click()
    expect(page.locator("#queue-line")).to_have_text("1 in the queue")
    page.get_by_role("button", name="Take demo out of the queue").click()
    expect(page.locator("#queue-line")).to_have_text("")
    until(lambda: bench.commands.recent[-1]["phase"] == "profile", "its rows")
    page.get_by_role("button", name="End the run demo").click()
    expect(page.locator("#state-word")).to_have_text("Idle")
    link = page.get_by_role("link", name="report of demo")
    expect(link).to_have_attribute("href", re.compile("^/runs/.*/report.html$"))


def test_a_temperature_is_held_by_its_number_alone(open_page: Open, bench: PageBench) -> None:
    page = open_page()
    expect(page.locator("#hold-note")).to_have_text("between 10 and 95 °C, the bench's limits")
    field, button = page.get_by_label("Hold", exact=True), page.get_by_role("button", name="Hold it")
    for text, says in (("", "temperature: expected a number"), ("warm", "temperature: expected"), ("300", "limits")):
        field.fill(text)
        button.click()
        expect(page.locator("#faults li")).to_contain_text([says])
    assert bench.commands.queue.tables() == []
    field.fill("60,5")
    button.click()
    expect(page.locator("#job-line")).to_contain_text("hold 60.5 degC")
    expect(page.locator("#faults")).to_be_hidden()


def test_no_line_is_drawn_over_a_gap_in_the_loop(open_page: Open, bench: PageBench) -> None:
    until(lambda: len(bench.commands.recent) > 2, "readings")
    bench.frozen = True
    bench.rows([time.time() - ago_s for ago_s in (601.0, 600.0)], 25.0)
    page = open_page()
    trail = page.locator("#loop-plot path.trail")
    expect(trail).to_have_attribute("d", re.compile(r"^M[^M]*L[^M]*M[^M]*L[^M]*$"))
    rows = [(0, 30), (1, 31), (300, 70), (301, 71), (302, 72)]  # live: nobody read for five minutes
    page.evaluate(
        """async (rows) => {
          const { loopRow } = await import("./loop.js");
          for (const [time_s, degC] of rows) {
            loopRow({ time_s, temperature_degC: degC, resistance_ohm: 1000 });
            await new Promise((done) => setTimeout(done, 260));
          }
        }""",
        rows,
    )
    expect(page.locator("#loop-plot path.fresh")).to_have_attribute("d", re.compile(r"^M[^M]*L[^M]*M[^M]*L[^M]*$"))


def test_faults_of_an_own_text_are_listed(open_page: Open, bench: PageBench) -> None:
    page = open_page()
    page.get_by_label("Configuration", exact=True).select_option("demo")
    page.locator("#text-summary").click()
    whole = page.locator("#text").input_value()
    page.locator("#text").fill("name = 1")
    expect(page.locator("#text-summary")).to_have_text("Your own text, changed from demo")
    page.get_by_role("button", name="Start the run").click()
    expect(page.locator("#faults li")).to_contain_text(["bench: missing", "limits: missing", "name: unknown key"])
    page.locator("#text").fill(f"# mine\n{whole}")
    page.get_by_label("Name of your own text").fill("mine")
    page.get_by_role("button", name="Start the run").click()
    expect(page.locator("#job-line")).to_contain_text("mine")
    expect(page.locator("#faults")).to_be_hidden()


def test_history_is_fetched_for_what_is_shown(open_page: Open, bench: PageBench) -> None:
    days = 20 * 86400
    bench.rows([time.time() - days + 3600.0 * k for k in range(24 * 19)], 25.0)
    page = open_page()
    expect(page.locator("#plot-resistance canvas")).to_be_visible()
    asked: list[tuple[float, float, int]] = []

    def note(request: Any) -> None:
        if found := re.search(r"from=([\d.]+)&to=([\d.]+)&points=(\d+)", request.url):
            asked.append((float(found[1]), float(found[2]), int(found[3])))

    page.on("request", note)

    def asks_for(span_s: float) -> None:
        for _ in range(100):
            if asked and asked[-1][1] - asked[-1][0] == pytest.approx(span_s, rel=0.05):
                assert 150 <= asked[-1][2] <= 2000
                return
            page.wait_for_timeout(50)
        raise AssertionError(f"{span_s} s were not asked for: {asked}")

    for name, span_s in (("1 d", 86400), ("1 month", 2_592_000), ("all", days)):
        page.get_by_role("button", name=name, exact=True).click()
        asks_for(span_s)
    page.locator("#plots").focus()
    page.keyboard.press("+")
    asks_for(days / 2 * 1.5)  # half, and a quarter of that beside it on both sides
    over = page.locator("#plot-current .u-over")
    box = over.bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 22, steps=3)
    page.mouse.up()
    asks_for(days / 2 * 0.2 * 1.5)
    expect(page.locator("#readout")).to_contain_text("°C")
    expect(page.get_by_role("button", name="live")).to_have_attribute("aria-pressed", "false")


def test_names_stay_text(open_page: Open, bench: PageBench) -> None:
    bench.shown = {"name": NASTY, "warnings": [NASTY]}
    job = bench.add_job(NASTY)
    page = open_page()
    expect(page.locator("#bench-name")).to_have_text(NASTY)
    expect(page.locator("#jobs td.run b")).to_have_text(NASTY)
    bench.trip_now(NASTY, NASTY)
    expect(page.locator("#latch-text")).to_have_text(NASTY)
    until(lambda: job.ended_s, "the job's end")
    bench.commands.queue.tables = lambda: [{**job.table(), "report": "javascript:alert(1)"}]  # type: ignore[method-assign]
    page.reload()
    expect(page.locator("#jobs td.run b")).to_have_text(NASTY)
    assert page.locator("#jobs a").count() == 0
    assert page.evaluate("document.body.dataset.pwned") is None


def test_it_comes_back_when_the_bench_does(open_page: Open, bench: PageBench) -> None:
    page = open_page()
    expect(page.locator("#state-word")).to_have_text("Idle")
    bench.close()
    expect(page.locator("#state-word")).to_have_text("No connection")
    expect(page.locator("#job-line")).to_have_text("last known: offline")
    with served(bench.folder, port=bench.port):
        expect(page.locator("#state-word")).to_have_text("Idle")
        expect(page.locator("#link-word")).to_have_text("live")
        page.close()


@pytest.mark.parametrize("bench", [{"token": "quince" * 3}], indirect=True)
def test_the_token_is_asked_once(open_page: Open, bench: PageBench) -> None:
    page = open_page()
    expect(page.locator("#state-word")).to_have_text("Token needed")
    page.get_by_label("Token", exact=True).fill("wrong")
    page.get_by_role("button", name="Open the bench").click()
    expect(page.locator("#token-said")).to_have_text("The bench did not take this token.")
    page.get_by_label("Token", exact=True).fill("quince" * 3)
    page.get_by_role("button", name="Open the bench").click()
    expect(page.locator("#token-panel")).to_be_hidden()
    expect(page.locator("#link-word")).to_have_text("live")
    expect(page.locator("#tile-current .number")).not_to_have_text("–")
    page.reload()
    expect(page.locator("#link-word")).to_have_text("live")
    expect(page.locator("#token-panel")).to_be_hidden()


def test_hidden_tabs_hold_no_connection(open_page: Open, bench: PageBench) -> None:
    page = open_page()
    expect(page.locator("#link-word")).to_have_text("live")
    page.clock.install()
    page.evaluate("Object.defineProperty(document, 'hidden', {get: () => window.away, configurable: true})")
    page.evaluate("window.away = true; document.dispatchEvent(new Event('visibilitychange'))")
    page.clock.run_for(6000)
    page.wait_for_timeout(300)
    assert bench.ask("GET", "/api/state")[1]["viewers"] == 0
    page.evaluate("window.away = false; document.dispatchEvent(new Event('visibilitychange'))")
    expect(page.locator("#link-word")).to_have_text("live")
    page.wait_for_timeout(300)
    assert bench.ask("GET", "/api/state")[1]["viewers"] == 1


def test_words_can_be_read_in_light_and_dark(open_page: Open, bench: PageBench) -> None:
    """Contrast of text on its card, WCAG AA."""
    ended = {"name": "film 6", "kind": "calibration", "state": "tripped", "reason": "over_temperature", "folder": None}
    bench.commands.queue.remember(
        [{**ended, "id": "p", "report": None, "queued_s": 1.0, "started_s": 2.0, "ended_s": 3.0}]
    )
    bench.add_job("film 7 tracking")
    bench.add_job("film 7 major loop")
    page = open_page(reduced_motion="reduce")
    expect(page.locator("#jobs td.why").first).to_be_visible()
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for selector in ("#state-word", "#output", ".tile .note", "#job-line", ".job", "#stop", "td.why", "#facts dt"):
            ratio = page.locator(selector).first.evaluate(CONTRAST)
            assert ratio >= 4.5, f"{scheme} {selector}: {ratio:.2f}"


CONTRAST = """node => {
  const parts = text => text.match(/[\\d.]+/g).map(Number);
  const light = rgb => rgb.slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  let under = node;
  while (parts(getComputedStyle(under).backgroundColor)[3] === 0) under = under.parentElement;
  const [a, b] = [getComputedStyle(node).color, getComputedStyle(under).backgroundColor].map(t => light(parts(t)));
  return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
}"""
