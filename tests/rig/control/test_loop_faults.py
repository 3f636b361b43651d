"""Faults in the middle of a run, on the virtual bench: an instrument dies, the output cannot be confirmed off."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import rig.bench.assembly
from tests.rig.small import write_bench

Peltier = Callable[..., tuple[int, str, str]]


class FallsSilent:
    """An instrument that stops answering (or obeying) at a time."""

    def __init__(self, instrument: Any, after_s: float) -> None:
        self._instrument, self._after_s = instrument, after_s

    def receive(self, data: bytes, time_s: float) -> None:
        if time_s < self._after_s:
            self._instrument.receive(data, time_s)

    def transmit(self, time_s: float) -> bytes:
        data: bytes = self._instrument.transmit(time_s)
        return data if time_s < self._after_s else b""

    def next_transmit_s(self) -> float | None:
        due = self._instrument.next_transmit_s()
        return due if due is not None and due < self._after_s else None


class SpeaksGarbage(FallsSilent):
    """An instrument whose answers turn into noise at a time."""

    def receive(self, data: bytes, time_s: float) -> None:
        self._instrument.receive(data, time_s)

    def transmit(self, time_s: float) -> bytes:
        data = self._instrument.transmit(time_s)
        if time_s < self._after_s or not data:
            return data
        return bytes((byte * 7 + 3) % 251 for byte in data) + b"\r\n"

    def next_transmit_s(self) -> float | None:
        return self._instrument.next_transmit_s()


def break_instrument(monkeypatch: pytest.MonkeyPatch, role: str, how: type[FallsSilent], after_s: float) -> None:
    whole = rig.bench.assembly.emulated_instruments

    def broken(file: Any, start_s: float) -> list[tuple[str, str, Any]]:
        return [(r, n, how(i, after_s) if r == role else i) for r, n, i in whole(file, start_s)]

    monkeypatch.setattr(rig.bench.assembly, "emulated_instruments", broken)


@pytest.mark.parametrize("how", [FallsSilent, SpeaksGarbage])
def test_the_meter_dies(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path, how: type[FallsSilent]
) -> None:
    break_instrument(monkeypatch, "meter", how, 30.0)
    status, _, err = peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert status == 10, err
    assert "no good reading of the ohmmeter" in err
    assert ("check its supply and its cable" in err) == (how is FallsSilent)  # one that speaks garbage has both
    assert "output off, confirmed" in err
    document = json.loads((tmp_path / "run.part" / "run.json").read_text())
    assert document["stop"]["reason"] == "ohmmeter_stale"
    assert document["stop"]["rows"] > 100


def test_the_controller_dies_and_off_cannot_be_confirmed(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path
) -> None:
    break_instrument(monkeypatch, "controller", FallsSilent, 30.0)
    status, _, err = peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert status == 11
    assert "NOT CONFIRMED OFF" in err
    said = re.search(r"nothing has come from it for (\S+) s: check its supply and its cable", err)
    assert said is not None
    assert 2.0 <= float(said[1]) < 3.0  # limits.stale_s, and the exchange that was under way
    document = json.loads((tmp_path / "run.part" / "run.json").read_text())
    assert document["stop"]["output_off_confirmed"] is False
