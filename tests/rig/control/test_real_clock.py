"""One experiment end to end on a real clock: over pseudo-terminals, beside endless loops, with an empty cache too."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.rig.small import MODEL

BUSY = "while True: sum(k * k for k in range(100000))"
CONFIGURATION = """
[bench]
time = "real"
[bench.controller]
driver = "meerstetter"
port = "{controller}"
[bench.meter]
driver = "keithley2000"
port = "{meter}"
[limits]
temperature_degC = [5, 95]
current_A = 4.0
[experiment]
kind = "temperature_profile"
model = "model.toml"
target = ["start 30 degC", "hold 2 s", "ramp to 40 degC at 1 K/s", "hold 3 s"]
settle_s = 1.0
[simulation]
first_degC = 25.0
[simulation.film]
kind = "model"
model = "model.toml"
"""


@pytest.fixture
def busy() -> Iterator[None]:
    """An endless loop a core; the suite's other processes are as good as loops."""
    others = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) - 1
    count = max(1, (os.cpu_count() or 1) - others)
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    yield
    for loop in loops:
        loop.kill()
        loop.wait()


@pytest.mark.long
@pytest.mark.parametrize("cache", ["compiled", "empty"])
def test_a_profile_beside_endless_loops(busy: None, root: Path, tmp_path: Path, cache: str) -> None:
    """To its end, and nobody was away from a plate with a current for longer than the interlock allows."""
    (tmp_path / "model.toml").write_text(MODEL)
    truth, path, noted = tmp_path / "truth.toml", tmp_path / "config.toml", tmp_path / "noted.json"
    truth.write_text(CONFIGURATION.format(controller="sim://", meter="sim://"))
    environment = {**os.environ, "PYTHONPATH": str(root)}
    command = [sys.executable, str(root / "benchmarks" / "_real_bench.py"), str(truth), str(noted)]
    bench = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert bench.stdout is not None
        ports = {line.split()[0]: line.split()[2] for line in (bench.stdout.readline(), bench.stdout.readline())}
        path.write_text(CONFIGURATION.format(**ports))
        done = subprocess.run(
            [sys.executable, "-m", "rig", "run", str(path), "--out", str(tmp_path / "run")],
            env=environment if cache == "compiled" else {**environment, "NUMBA_CACHE_DIR": str(tmp_path / "empty")},
            capture_output=True,
            text=True,
            timeout=280.0,
        )
    finally:
        bench.terminate()
        bench.wait(10.0)
        bench.stdout.close() if bench.stdout is not None else None
    assert done.returncode == 0, done.stderr
    assert "output off, confirmed by the controller" in done.stdout + done.stderr
    ticks = json.loads((tmp_path / "run" / "run.json").read_text())["stop"]["ticks"]
    assert ticks["done"] > 100
    assert ticks["unwatched_s"] < 2.0  # limits.stale_s
    told = json.loads(noted.read_text())
    assert told["on_A"] == 0.0
    assert told["unread_s"] < 2.0
