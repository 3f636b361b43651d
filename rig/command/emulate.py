"""peltier emulate CONFIG [--speed X]: the simulated instruments on pseudo-terminals, until stopped.

Prints a line an instrument, `controller meerstetter /dev/pts/3`, and nothing else on stdout; then serves in real time
(times X). The instruments share one plant. On stderr it says what a heater would not: that a program has left the
output on, or that the controller has switched it off by itself; and at the end whether it is off.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from rig.core.faults import fault
from rig.core.requirements import require

LOOK_S = 0.2  # between looks at the output: a line on stderr need not come sooner
SILENT_S = 5.0  # with the output on, after which a program has ended or hangs: those that steer speak once a second
FASTEST = 1e4  # times real time: beyond it, no computer keeps up with the simulated plant


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="times real time (1)")


def main(options: argparse.Namespace) -> int:
    from rig.config.configuration import read_configuration

    require("emulate")
    if not 1e-6 <= options.speed <= FASTEST:
        raise fault("--speed", repr(options.speed), f"expected a number from 1e-6 to {FASTEST:g}")
    file = read_configuration(options.config, for_experiment=False)
    from rig.bench.assembly import emulated_instruments
    from rig.bench.simulation import simulated_world
    from rig.ports.pseudo_terminal import PseudoTerminals
    from rig.safety.signals import SignalStop
    from sim.world.plant import SimulatedPlant

    first = SimulatedPlant(simulated_world(file), 0.0)  # its loops are compiled before anybody can ask: whoever asked
    first.advance_to(1.0)  # meanwhile would have no answer in time
    if file.content.bench.meter is not None:
        first.read_resistance_ohm(1e-4)
    plant = SimulatedPlant(simulated_world(file), 0.0)
    instruments = emulated_instruments(file, 0.0, plant)
    with SignalStop(), PseudoTerminals({role: i for role, _, i in instruments}, speed=options.speed) as terminals:
        for role, name, _ in instruments:
            print(f"{role} {name} {terminals.paths[role]}", flush=True)
        output = Output()
        try:
            while terminals.failure is None:
                time.sleep(LOOK_S)
                for line in output.seen(plant.current_A, terminals.heard_s.get("controller", 0.0), time.monotonic()):
                    print(line, file=sys.stderr, flush=True)
            raise terminals.failure
        finally:
            print(f"controller: at the end {in_words(plant.current_A)}", file=sys.stderr, flush=True)


def in_words(current_A: float) -> str:
    """Return in words if the output is on; a simulated current is what flows, to the last bit."""
    return f"its output is on, {current_A:.3g} A" if current_A != 0.0 else "its output is off"


class Output:
    """Lines on the output as it is seen, LOOK_S after LOOK_S."""

    def __init__(self) -> None:
        self._current_A, self._looked_s, self._said = 0.0, 0.0, False

    def seen(self, current_A: float, heard_s: float, now_s: float) -> list[str]:
        """Return lines, mostly none. heard_s: when the controller was written to last, on the scale of now_s (s)."""
        before_A, looked_s = self._current_A, self._looked_s
        self._current_A, self._looked_s = current_A, now_s
        silent_s = now_s - heard_s
        if before_A != 0.0 and current_A == 0.0 and heard_s < looked_s - LOOK_S:
            self._said = False
            return [f"controller: it has switched its output off by itself, after {silent_s:.1f} s without a command"]
        if silent_s < SILENT_S or current_A == 0.0:
            self._said = False
            return []
        said, self._said = self._said, True
        return [] if said else [f"controller: {in_words(current_A)}, and nobody has spoken to it for {silent_s:.0f} s"]
