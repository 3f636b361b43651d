"""An hour of the fortnight, a few of its kills, and a few latched benches: the benchmarks run small."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


def benchmark(root: Path, tmp_path: Path, name: str, *words: str) -> dict[str, object]:
    result = tmp_path / "result.json"
    command = [sys.executable, str(root / "benchmarks" / f"{name}.py"), *words, "--json", str(result)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(result.read_text())
    return found


@pytest.mark.long
def test_an_hour_of_the_fortnight(root: Path, tmp_path: Path) -> None:
    found = benchmark(root, tmp_path, "fortnight", "--days", str(3700 / 86400))
    assert (found["lost"], found["damage"]) == (0, None)
    assert isinstance(found["done"], int)
    assert found["done"] >= 3590


def test_nothing_shown_is_lost_by_kills_and_full_disks(root: Path, tmp_path: Path) -> None:
    found = benchmark(root, tmp_path, "history_kills", "--kills", "4")
    assert (found["lost"], found["damaged"]) == (0, 0)
    assert isinstance(found["full"], list)
    for full in found["full"]:
        assert (full["lost"], full["damage"], full["told"]) == (0, None, True)


@pytest.mark.long
def test_a_trip_survives_kills_damage_and_full_disks_and_a_new_bench_has_none(root: Path, tmp_path: Path) -> None:
    found = benchmark(root, tmp_path, "latch", "--count", "1")
    assert (found["still_tripped"], found["not_ended"]) == (1, 0)
    assert (found["new_tripped"], found["reset_tripped"]) == (0, 0)
