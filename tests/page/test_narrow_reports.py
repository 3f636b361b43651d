"""A report in a window as narrow as a telephone's: it is read from top to bottom, not from side to side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.report.batch import _records_table as many_table
from rig.report.page import paragraph, section, table, tiles, write_page

NARROW = 400  # a telephone's width, px


def test_nothing_makes_the_page_wider_than_the_window(browser: Any, tmp_path: Path) -> None:
    wide = ["resistance_over_capacity_K_per_A2_s"] * 6
    parts = [
        tiles([("24.2 \N{RIGHTWARDS ARROW} 1.77 mdec of nine", "error of log R"), ("tanh", "form of D(T)")]),
        section("Effects", table(wide, [wide]), table(wide, [wide], kind="words")),
        paragraph("/home/somebody/" + "x" * 80 + ".csv"),
    ]
    write_page(tmp_path / "report.html", "20261127T211816Z_first_film_a05bcd: tracking", "lead", parts)
    page = browser.new_page(viewport={"width": NARROW, "height": 800})
    page.goto((tmp_path / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= NARROW
    within = "node => [...node.querySelectorAll('.tile b')].every(one => one.scrollWidth <= one.clientWidth)"
    assert page.locator("body").evaluate(within)
    page.close()


def test_the_table_of_many_records_has_room_for_each_column(browser: Any, tmp_path: Path) -> None:
    named = "thermometer_quantization:step_K=0.25 "
    named += "heat_sink_warmup:sink_capacity_ratio=3.731,sink_conductance_ratio_per_s=0.04023"
    row = {"record": "evening/peltier_8010.csv", "status": "done", "folder": "f", "verdict": "partly_unexplained"}
    row |= {"named": named, "left": "temperature_K: structure in blocks of 36 rows", "rows": 701, "duration_s": 425.6}
    columns = {"verdict": "verdict", "named": "effects and sizes", "left": "left over"}
    write_page(tmp_path / "report.html", "Diagnoses", "lead", [many_table([row], columns)])
    page = browser.new_page(viewport={"width": 1400, "height": 800})
    page.goto((tmp_path / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 1400
    table = page.locator(".words")
    assert table.evaluate("node => node.scrollWidth <= node.clientWidth")
    widths = table.locator("tbody td").evaluate_all("cells => cells.map(cell => cell.clientWidth)")
    assert min(widths) >= 100  # px: some words to a line
    page.close()
