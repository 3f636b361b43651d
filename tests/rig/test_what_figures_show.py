"""Figures show what their labels say: residuals have one sign, and no line goes through a gap.

A reader who takes a label at its word corrects a model in the wrong direction where the sign is the other one, and sees
a measurement where there is none where a line goes on through a gap.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TextIO, cast

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from rig.analysis.error import RESIDUAL, residual, residual_dec
from rig.records.record_file import read_record, write_columns
from rig.report.diagnosis import residuals
from rig.report.page import (
    BLUE,
    DARK,
    GOLD,
    GREEN,
    MOST_POINTS,
    PAPER,
    PURPLE,
    RED,
    draw_line,
    log_scale,
    new_figure,
    saved,
    thinned,
)
from sim.inference.record.quantity import Quantity
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench
from tests.sim.diagnosis.plate_record import levels, record

GAP_S = (20.0, 40.0)  # of every record here: no row in between


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures of the reports that a test writes, each once; they are not drawn."""
    found: list[Figure] = []

    def savefig(self: Figure, file: TextIO, **settings: object) -> None:
        file.write("<svg></svg>")
        if self not in found:
            found.append(self)

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", savefig)
    return found


def lines(figures: list[Figure], label: str = "") -> list[tuple[Line2D, str, str]]:
    """(line, label of its abscissa or of that below it, label of its ordinate) of what is drawn over data."""
    return [
        (line, axes.get_xlabel() or figure.axes[-1].get_xlabel(), axes.get_ylabel())
        for figure in figures
        for axes in figure.axes
        for line in axes.lines
        if label in (axes.get_ylabel() + axes.get_xlabel()) and line.get_transform() == axes.transData
    ]


def film_record(path: Path) -> Path:
    """A film of far less resistance than the model of tests.rig.small; rows of GAP_S are missing."""
    time = np.arange(0.0, 60.5, 0.5)
    time = time[(time <= GAP_S[0]) | (time >= GAP_S[1])]
    degC = 45.0 + 30.0 * np.sin(time / 8.0)
    write_columns(path, {"time_s": time, "temperature_degC": degC, "resistance_ohm": np.full(time.size, 1e3)})
    (path.parent / "model.toml").write_text(MODEL)
    return path


@pytest.mark.parametrize(
    ("output", "sign"), [("minus_log10_ohm", -1.0), ("log10_ohm", 1.0), ("curvature_per_m", 1.0), ("", 1.0)]
)
def test_a_residual_is_measured_less_model_of_what_was_measured(output: str, sign: float) -> None:
    """A film's output may be the negative of what was measured: 143.9 ohm where 20,701 were predicted is below 0."""
    measured, model = np.array([sign * np.log10(143.9)]), np.array([sign * np.log10(20701.0)])
    assert residual(measured, model, output) == pytest.approx([-2.158], abs=1e-3)
    assert residual_dec(np.array([143.9]), np.array([20701.0])) == pytest.approx([-2.158], abs=1e-3)


@pytest.mark.parametrize("name", ["minus_log10_ohm", "log10_ohm", "curvature_per_m", "minus_curvature_per_m"])
def test_a_diagnosis_counts_a_residual_in_what_was_measured(name: str) -> None:
    quantity = Quantity(name, centre=0.5, size=2.0 if "curvature" in name else 1.0)
    values = {quantity.column: np.array([10.0, 100.0, 1000.0])}
    modelled = {quantity.column: np.array([20.0, 100.0, 100.0])}
    output, shown = quantity.of(values), quantity.of(modelled)
    one = SimpleNamespace(quantity=quantity, output=output, output_used=np.ones(3, dtype=bool))
    diagnosis: Any = SimpleNamespace(record=one, shown=lambda fit: {quantity.channel: shown})
    left = residuals(diagnosis, cast(Any, None))[quantity.channel]
    expected = [np.log10(0.5), 0.0, 1.0] if quantity.is_resistance else [-10.0, 0.0, 900.0]
    assert left == pytest.approx(expected)


def test_a_prediction_has_one_sign_everywhere(peltier: Peltier, tmp_path: Path, figures: list[Figure]) -> None:
    path = film_record(tmp_path / "film.csv")
    words = ["--out", tmp_path / "out.csv", "--report", tmp_path / "report", "--json", tmp_path / "out.json"]
    out = peltier.succeeds("predict", tmp_path / "model.toml", path, *words)
    with (tmp_path / "out.csv").open() as file:
        rows = list(csv.DictReader(file))
    expected = np.array([np.log10(float(r["resistance_ohm"]) / float(r["predicted_ohm"])) for r in rows])
    assert float(np.mean(expected)) < -0.5
    assert [float(r["residual_dec"]) for r in rows] == pytest.approx(expected, abs=1e-9)
    assert json.loads((tmp_path / "out.json").read_text())["mean_residual_dec"] == pytest.approx(np.mean(expected))
    assert f"mean of {RESIDUAL} {np.mean(expected):+.4f} dec" in out
    dots = [line for line, x, y in lines(figures, f"{RESIDUAL} / dec") if x == "time / s"]
    assert [line.get_ydata().tolist() for line in dots] == [pytest.approx(expected)]  # type: ignore[union-attr]


def test_an_identification_has_that_sign_too(peltier: Peltier, tmp_path: Path, figures: list[Figure]) -> None:
    columns = record(25.0, levels(3, 12), 3)
    write_columns(tmp_path / "plate.csv", columns)
    assert peltier("identify", tmp_path / "plate.csv", "--report", tmp_path / "report")[0] == 0
    of = {line.get_label(): line.get_ydata() for line, _, y in lines(figures, "temperature /")}
    (left,) = [line.get_ydata() for line, _, y in lines(figures, RESIDUAL)]
    assert left == pytest.approx(np.asarray(of["measured"]) - np.asarray(of["model"]))


def through(figures: list[Figure], low: float, high: float) -> list[str]:
    """Labels of the lines over time that join a point before a gap with one after it."""
    found = []
    for line, x_label, y_label in lines(figures):
        x = np.asarray(line.get_xdata(), dtype=float)
        joined = np.isfinite(x[:-1]) & np.isfinite(x[1:]) & (x[:-1] <= low) & (x[1:] >= high)
        if x_label.startswith("time") and line.get_linestyle() != "None" and np.any(joined):
            found.append(f"{y_label}: {line.get_label()}")
    return found


def test_no_line_of_a_model_goes_through_a_gap(peltier: Peltier, tmp_path: Path, figures: list[Figure]) -> None:
    film = film_record(tmp_path / "film.csv")
    columns = record(25.0, levels(4, 12), 4)
    time = columns["time_s"]
    seen = (time <= GAP_S[0]) | (time >= GAP_S[1])
    write_columns(tmp_path / "plate.csv", {name: values[seen] for name, values in columns.items()})
    for words in (
        ("predict", tmp_path / "model.toml", film, "--report", tmp_path / "1"),
        ("identify", tmp_path / "plate.csv", "--report", tmp_path / "2"),
        ("diagnose", tmp_path / "plate.csv", "--budget", "5", "--report", tmp_path / "3"),
    ):
        before = len(figures)
        assert peltier(*words)[0] == 0
        assert any(line.get_linestyle() != "None" for line, _, _ in lines(figures[before:]))
        assert through(figures[before:], *GAP_S) == []
    page = (tmp_path / "3" / "report.html").read_text(encoding="utf-8")
    assert page.index("The temperature as measured") < page.index("<h2>Effects")  # what was measured comes first


def test_no_line_of_a_run_goes_through_a_gap(peltier: Peltier, tmp_path: Path, figures: list[Figure]) -> None:
    """Rows may be missing of a run whose computer stood still."""
    bench = write_bench(tmp_path, target='["start 20 kohm", "ramp to 8 kohm in 1 s", "hold 14 s"]')
    assert peltier("run", bench, "--out", tmp_path / "run")[0] == 0
    shutil.copytree(tmp_path / "run", tmp_path / "cut")
    (tmp_path / "cut" / "record.nc").unlink(missing_ok=True)
    whole = read_record(tmp_path / "run" / "record.csv", options=False)
    track = np.array(whole.text_columns["phase"]) == "track"
    begin = float(whole["time_s"][track][0])
    seen = (whole["time_s"] <= begin + 3.0) | (whole["time_s"] >= begin + 6.0)
    columns = {name: np.asarray(values)[seen] for name, values in {**whole.columns, **whole.text_columns}.items()}
    write_columns(tmp_path / "cut" / "record.csv", columns)
    figures.clear()
    assert peltier("report", tmp_path / "cut")[0] == 0
    assert {y for _, _, y in lines(figures)} > {"resistance / ohm", "temperature / \N{DEGREE SIGN}C", "current / A"}
    assert through(figures, 3.05, 5.95) == []


def test_a_line_breaks_where_readings_are_missing_and_nowhere_else() -> None:
    """Also where the rows are there and their readings are not, and among more rows than are drawn."""
    time = np.arange(30_000.0)
    values = np.sin(time / 300.0)
    values[5_000:5_020] = np.nan
    values[9_000] = np.nan
    time[20_000:] += 7.0
    _, (axes,) = new_figure(1, 3.0)
    draw_line(axes, time, values)
    x = np.asarray(axes.lines[0].get_xdata(), dtype=float)
    inside = np.flatnonzero(np.isnan(x))
    assert [(x[k - 1], x[k + 1]) for k in inside] == [(4999.0, 5020.0), (8999.0, 9001.0), (19_999.0, 20_007.0)]


def test_a_reading_alone_between_gaps_is_seen() -> None:
    _, (axes,) = new_figure(1, 3.0)
    draw_line(axes, [0.0, 1.0, 2.0, 30.0, 60.0, 61.0, 62.0, 63.0, *range(64, 90)], np.ones(34))
    assert axes.lines[1].get_xdata() == pytest.approx([30.0])
    assert axes.lines[1].get_marker() == "o"


def contrast(one: str, other: str) -> float:
    """The contrast of two colours, as the Web Content Accessibility Guidelines (WCAG 2.2) define it."""

    def luminance(colour: str) -> float:
        part = np.array([int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
        linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_lines_are_seen_on_white_and_on_dark_paper() -> None:
    """3 to 1 is what the guidelines ask of lines; dots are pictures in an SVG, which no style sheet can change."""
    for colour in (BLUE, RED, GOLD, GREEN, PURPLE):
        assert contrast(colour, PAPER) >= 3.0
        assert contrast(colour, DARK[PAPER]) >= 3.0


def test_every_fixed_colour_of_a_figure_is_seen_in_the_dark(peltier: Peltier, tmp_path: Path) -> None:
    """A dark grey word that the style sheet does not know stays dark grey on black."""
    path = film_record(tmp_path / "film.csv")
    assert peltier("predict", tmp_path / "model.toml", path, "--report", tmp_path / "report")[0] == 0
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    used = set(re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)))
    assert len(used) > 5
    for colour in used - set(DARK):
        assert contrast(colour, DARK[PAPER]) >= 3.0, colour
    for colour in used & set(DARK):
        for what in ("fill", "stroke"):
            assert f'[style*="{what}: {colour}"] {{ {what}: {DARK[colour]} !important }}' in page


@pytest.mark.parametrize(
    ("low_ohm", "high_ohm", "label"), [(1e2, 1e6, "10\N{THIN SPACE}k"), (7.9e4, 8.1e4, "80\N{THIN SPACE}k")]
)
def test_labels_of_a_log_scale_are_plain_text(tmp_path: Path, low_ohm: float, high_ohm: float, label: str) -> None:
    figure, axes = new_figure(1, 3.0)
    axes[0].plot(np.geomspace(low_ohm, high_ohm, 50))
    log_scale(axes[0])
    text = saved(figure, tmp_path, "t", "caption")
    assert f">{label}<" in text
    assert "times" not in text
    assert not any("$" in tick.get_text() for tick in axes[0].get_yticklabels(which="both"))


def test_no_peak_is_lost_among_a_week_of_rows() -> None:
    size = 600_000
    time, steady, other = np.arange(size, dtype=float), np.zeros(size), np.full(size, np.nan)
    steady[[1234, 599_001]] = 5.0, -7.0
    steady[300_000] = np.inf  # beyond the range: no peak, and it hides none
    steady[300_001] = 3.0
    other[400_000:400_200] = 1.0
    t, shown, rest = thinned(time, steady, other)
    assert t.size <= MOST_POINTS
    assert np.all(np.diff(t) > 0.0)
    assert (t[0], t[-1]) == (0.0, size - 1.0)
    assert [float(t[k]) for k in np.flatnonzero(shown != 0.0) if np.isfinite(shown[k])] == [
        1234.0,
        300_001.0,
        599_001.0,
    ]
    assert np.any(rest == 1.0)
    np.testing.assert_array_equal(steady[t.astype(int)], shown)
