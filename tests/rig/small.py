"""Small configurations for tests: a quick simulated bench, and a model that fits it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rig.bench.assembly import emulated_instruments

MODEL = """
[film]
kind = "extended_generalized_pi"
output = "minus_log10_ohm"
radii = [0.05, 0.2, 0.5, 0.8]
weights = [0.4, 0.3, 0.2, 0.1]
initial = "cooled"
[film.rising]
function = "tanh"
a = 0.2
b = -12.6
[film.falling]
function = "tanh"
a = 0.2
b = -11.8
[film.memoryless]
function = "tanh"
amplitude = 0.4
a = 0.03
b = -1.6
offset = -4.0
[plate]
kind = "peltier"
seebeck_over_capacity_per_A_s = 1.6e-3
resistance_over_capacity_K_per_A2_s = 0.06
conductance_over_capacity_per_s = 0.018
ambient_degC = 25.0
"""

BENCH = """
[bench]
time = "{time}"
[bench.controller]
driver = "meerstetter"
port = "{controller}"
[bench.meter]
driver = "keithley2000"
port = "{meter}"
[limits]
temperature_degC = {limits}
current_A = 4.0
meter_current_A = 1e-3
"""

EXPERIMENT = """
[experiment]
kind = "{kind}"
model = "model.toml"
target = {target}
period_s = 0.1
settle_s = 3.0
"""

SIMULATION = """
[simulation]
first_degC = 60.0
[simulation.film]
kind = "model"
model = "model.toml"
"""


def write_bench(
    folder: Path,
    *,
    target: str = '["start 20 kohm", "hold 5 s", "ramp to 5 kohm at 0.1 dec/s", "hold 5 s"]',
    time: str = "virtual",
    controller: str = "sim://",
    meter: str = "sim://",
    limits: str = "[10, 95]",
    kind: str = "track_resistance",
    experiment: str = "",
    more: str = "",
    changed: Sequence[tuple[str, str]] = (),
) -> Path:
    """model.toml and config.toml in a folder; returns the configuration's path. kind: of the
    experiment; experiment: its whole table, in the place of one that follows the target; changed: what stands there
    instead, wherever the first of a pair does."""
    (folder / "model.toml").write_text(MODEL)
    bench = BENCH.format(time=time, controller=controller, meter=meter, limits=limits)
    text = bench + (experiment or EXPERIMENT.format(kind=kind, target=target)) + SIMULATION + more
    for old, new in changed:
        assert old in text
        text = text.replace(old, new)
    (folder / "config.toml").write_text(text)
    return folder / "config.toml"


def change_instrument(monkeypatch: pytest.MonkeyPatch, role: str, change: Callable[[Any], Any]) -> None:
    """Put what `change` makes of a simulated bench's controller, or meter, in its place."""

    def changed(file: Any, start_s: float) -> list[tuple[str, str, Any]]:
        found = emulated_instruments(file, start_s)
        return [(at, name, change(one) if at == role else one) for at, name, one in found]

    monkeypatch.setattr("rig.bench.assembly.emulated_instruments", changed)


@contextmanager
def no_file_above(size_bytes: int) -> Iterator[None]:
    """The kernel refuses bytes beyond this size (EFBIG, as ENOSPC would)."""
    import resource

    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.getsignal(signal.SIGXFSZ)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
