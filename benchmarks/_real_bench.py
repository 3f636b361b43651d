"""Emulated instruments on pseudo-terminals that note what is on and when it was read: `_real_bench.py CONFIG OUT`.

Prints the instruments' ports as `peltier emulate` does; writes OUT (JSON) once a second: the longest time with a
current on and no reading of the thermometer, at this end of the wire.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import rig.bench.assembly
from rig.config.configuration import read_configuration
from rig.ports.pseudo_terminal import PseudoTerminals
from sim.world.plant import SimulatedPlant


class NotingPlant(SimulatedPlant):
    """The simulated plant, noting. unread_s: longest time with a current on and no reading."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.unread_s, self.read_s, self.hottest_degC, self.readings = 0.0, 0.0, -300.0, 0
        self.on_s: float | None = None

    def set_current_A(self, current: float) -> None:
        self._note()
        if current != 0.0 and self.on_s is None:
            self.on_s = self.read_s = self.time_s
        elif current == 0.0:
            self.on_s = None
        super().set_current_A(current)

    def read_temperature_degC(self) -> float:
        self._note()
        return super().read_temperature_degC()

    def _note(self) -> None:
        if self.on_s is not None:
            self.unread_s = max(self.unread_s, self.time_s - self.read_s)

    def asked(self) -> None:
        """The host has asked for the temperature."""
        self._note()
        self.read_s = self.time_s
        self.readings += 1
        self.hottest_degC = max(self.hottest_degC, self.temperature_degC)


def main() -> None:
    path, out = Path(sys.argv[1]), Path(sys.argv[2])
    with contextlib.suppress(OSError):
        os.nice(-10)  # an instrument is not late because the computer is busy
    plants: list[NotingPlant] = []

    def plant(world: Any, start_s: float) -> NotingPlant:
        plants.append(NotingPlant(world, start_s))
        return plants[-1]

    rig.bench.assembly.SimulatedPlant = plant  # type: ignore[assignment,misc]
    instruments = rig.bench.assembly.emulated_instruments(read_configuration(path), 0.0)
    controller: Any = instruments[0][2]
    answered = controller._measured[1000]

    def temperature() -> float:
        plants[0].asked()
        return float(answered())

    controller._measured[1000] = temperature
    done = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: done.set())
    with PseudoTerminals({role: i for role, _, i in instruments}) as terminals:
        for role, name, _ in instruments:
            print(f"{role} {name} {terminals.paths[role]}", flush=True)
        while not done.is_set():
            done.wait(1.0)
            p = plants[0]
            out.write_text(
                json.dumps(
                    {
                        "unread_s": p.unread_s,
                        "hottest_degC": p.hottest_degC,
                        "readings": p.readings,
                        "on_A": p.current_A,
                    }
                )
            )


if __name__ == "__main__":
    main()
