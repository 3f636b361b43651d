"""peltier trend: series over runs, a change that is told with its date, none that is not there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rig.analysis.trend import latest_change, series_of
from tests.peltier import Peltier

NIGHTS = 60


def _series(seed: int, change: float, tails: bool) -> tuple[np.ndarray, np.ndarray]:
    """Values whose intervals are right, or a little too narrow with heavy tails; `change` errors from the middle on."""
    random = np.random.default_rng(seed)
    error = random.uniform(0.7, 1.4, NIGHTS)
    noise = random.standard_t(4, NIGHTS) if tails else random.standard_normal(NIGHTS)
    return 10.0 + noise * error + np.where(np.arange(NIGHTS) >= NIGHTS // 2, change, 0.0), error


@pytest.mark.parametrize("tails", [False, True])
def test_a_change_is_found_within_three_nights_and_dated(tails: bool) -> None:
    found = 0
    for seed in range(20):
        value, error = _series(seed, 3.0 * 2.0 * 1.96, tails)
        seen = [latest_change(value[:n], error[:n]) for n in range(NIGHTS // 2 + 1, NIGHTS // 2 + 4)]
        found += any(change is not None and abs(change.since - NIGHTS // 2) <= 1 for change in seen)
    assert found >= 19


def test_nothing_is_told_where_nothing_changed() -> None:
    told = sum(latest_change(*_series(1000 + seed, 0.0, tails=seed % 2 == 1)) is not None for seed in range(60))
    assert told <= 6  # at 5 % a series: 3 expected, 7 or more in 3 of 100 such sets


def test_an_effect_that_appears_or_goes_is_told() -> None:
    value = np.where(np.arange(NIGHTS) >= 40, 2.0, np.nan)
    appears = latest_change(value[:43], np.ones(43))
    assert appears is not None
    assert (appears.kind, appears.since) == ("appears", 40)
    gone = latest_change(value[::-1][:23], np.ones(23))
    assert gone is not None
    assert (gone.kind, gone.since) == ("gone", 20)
    now_and_then = np.where(np.random.default_rng(2).random(NIGHTS) < 0.4, 2.0, np.nan)
    assert latest_change(now_and_then, np.ones(NIGHTS)) is None


def test_rigs_are_apart_and_what_changed_comes_first() -> None:
    rows = [
        {
            "at": f"2026-11-{1 + k:02d}T20:00:00+00:00",
            "rig": rig,
            "verdict": "explained",
            "film_lag.tau_s": tau + 0.01 * (k % 3),
            "film_lag.tau_s.low": tau - 0.1,
            "film_lag.tau_s.high": tau + 0.1,
        }
        for rig in ("one", "two")
        for k in range(20)
        for tau in [3.0 if rig == "two" and k >= 12 else 2.0]
    ]
    first, second = series_of(rows)
    assert (first.rig, first.since[:10]) == ("two", "2026-11-13")
    assert first.change is not None
    assert first.change.before[0] == pytest.approx(2.01, abs=0.01)
    assert first.change.after[0] == pytest.approx(3.01, abs=0.01)
    assert second.change is None
    assert "since 2026-11-13" in first.in_words()


def _run_folder(folder: Path, record: Path, at: str, serial: str) -> None:
    folder.mkdir(parents=True)
    (folder / "record.csv").write_bytes(record.read_bytes())
    start = {"at": at, "instruments": {"controller": {"maker": "M", "model": "T", "serial_number": serial}}}
    document = {"format": "peltier-run/1", "start": start, "stop": {"reason": "done"}}
    (folder / "run.json").write_text(json.dumps(document))


def test_a_folder_of_runs_is_diagnosed_once(tmp_path: Path, peltier: Peltier) -> None:
    seconds = np.arange(0.0, 300.0, 1.0)
    current = np.where(seconds % 120.0 < 60.0, 0.8, -0.4)
    plate, degC = 25.0, []
    random = np.random.default_rng(1)
    for ampere in current:
        degC.append(plate + 0.01 * random.standard_normal())
        plate += 0.4 * ampere + 0.02 * ampere**2 - 0.02 * (plate - 25.0)
    record = tmp_path / "record.csv"
    rows = [f"{t},{v:.4f},{i}" for t, v, i in zip(seconds, degC, current, strict=True)]
    record.write_text("\n".join(["time_s,temperature_degC,current_A", *rows]) + "\n")
    for day in (1, 2):
        _run_folder(tmp_path / "runs" / f"night{day}", record, f"2026-11-0{day}T20:00:00+00:00", "7")
    out = tmp_path / "trend"
    words = ("trend", tmp_path / "runs", "--out", out, "--workers", 1, "--json", "-")
    text = peltier.succeeds(*words)
    assert [run["run"] for run in json.loads(text)["runs"]] == ["night1", "night2"]
    assert len((out / "cases.jsonl").read_text().splitlines()) == 2
    assert "night2" in (out / "report.html").read_text()
    status, _, err = peltier(*words)
    assert status == 0
    assert "cases" not in err  # nothing was diagnosed again
    assert peltier("trend", tmp_path / "nothing")[0] == 2
