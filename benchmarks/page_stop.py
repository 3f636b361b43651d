"""STOP pressed in a real browser until the bench has the command; asked: 200 ms in the median.

    python benchmarks/page_stop.py [--presses 50] [--url http://127.0.0.1:8765/] [--configuration demo] [--json FILE]

Without --url a bench of the tests is served, which notes the moment when the command arrives. With --url a daemon is
asked that runs already (`peltier serve` on emulated instruments: it is STOPPED and reset again and again); then the
moment counts when the page has the answer 'off, confirmed', which is later than the instrument's; with
--configuration a run is started before each press and its output is on when STOP is pressed. A press is a real
key or mouse event of the browser, timed by the event's own time stamp.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from playwright.sync_api import Page, sync_playwright

from tests.rig.web.fake_bench import FakeBench, served

ASKED_MS = 200.0
WATCH = """() => {
  window.pressed = [];
  window.answered = [];
  for (const kind of ['pointerdown', 'keydown']) {
    addEventListener(kind, event => window.pressed.push(performance.timeOrigin + event.timeStamp), {capture: true});
  }
  const ask = window.fetch;
  window.fetch = async (...words) => {
    const answer = await ask(...words);
    if (String(words[0]).endsWith('/api/stop')) {
      const told = await answer.clone().json();
      window.answered.push([performance.timeOrigin + performance.now(), told.off === true && told.confirmed === true]);
    }
    return answer;
  };
}"""

ANSWER = """() => new Promise(done => {
  const look = () => answered.length ? done([pressed[0], answered[0]]) : setTimeout(look, 10);
  look();
})"""


def press(page: Page, count: int) -> tuple[float, float]:
    """One press, by mouse and by keyboard in turn; (ms when pressed, ms when answered), Unix time."""
    page.evaluate("pressed.length = answered.length = 0")
    if count % 2:
        page.keyboard.press("Escape")
    else:
        page.mouse.click(*centre(page))
    pressed, (answered, sure) = page.evaluate(ANSWER)
    if not sure:
        raise SystemExit("the bench did not confirm that the output is off")
    return float(pressed), float(answered)


def centre(page: Page) -> tuple[float, float]:
    """The middle of the button."""
    box = page.locator("#stop").bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def reset(page: Page) -> None:
    """Clear the stop, so that the next press finds a bench that may run."""
    page.wait_for_selector("#latch", state="visible")
    page.locator("#reason").fill("benchmark")
    page.locator("#reset-form button").click()
    page.wait_for_selector("#latch", state="hidden")
    page.locator("#state-word").click()


def start(page: Page, name: str) -> None:
    """Start a listed configuration and wait until the output is on."""
    page.locator("#configuration").select_option(name)
    page.locator("#start-button").click()
    page.wait_for_selector("#output:text-is('output on')")
    page.locator("#state-word").click()


def measure(presses: int, url: str | None, configuration: str | None) -> dict[str, float]:
    """Medians and longest, ms."""
    bench = FakeBench()
    to_server, to_answer = [], []
    context: Any = served(bench) if url is None else nullcontext()
    with context as server, sync_playwright() as playwright:
        path = shutil.which("chromium") or shutil.which("google-chrome")
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(url or server.address)
        page.wait_for_selector("#link[data-link=live]")
        page.evaluate(WATCH)
        if page.locator("#latch").is_visible():
            reset(page)
        for count in range(presses):
            if configuration:
                start(page, configuration)
            pressed_ms, answered_ms = press(page, count)
            to_answer.append(answered_ms - pressed_ms)
            if url is None:
                to_server.append(bench.stops[-1] * 1e3 - pressed_ms)
            reset(page)
        browser.close()
    figures = {"press_to_confirmed_ms": statistics.median(to_answer), "longest_to_confirmed_ms": max(to_answer)}
    if to_server:
        figures |= {"press_to_server_ms": statistics.median(to_server), "longest_to_server_ms": max(to_server)}
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presses", type=int, default=50)
    parser.add_argument("--url")
    parser.add_argument("--configuration")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    figures = measure(options.presses, options.url, options.configuration)
    for name, value in figures.items():
        asked = f"    asked <= {ASKED_MS:g}" if name.startswith("press") else ""
        print(f"{name:26s} {value:7.1f}{asked}")
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=1))
    return 0 if figures["press_to_confirmed_ms"] <= ASKED_MS else 1


if __name__ == "__main__":
    sys.exit(main())
