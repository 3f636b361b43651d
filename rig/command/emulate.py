"""peltier emulate CONFIG [--speed X]: the simulated instruments on pseudo-terminals, until stopped.

Prints a line an instrument, `controller meerstetter /dev/pts/3`, and nothing else on stdout; then serves in real time
(times X). The instruments share one plant.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from rig.core.faults import fault
from rig.core.posix_only import require

FASTEST = 1e4  # times real time: beyond it, no computer keeps up with the simulated plant


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="times real time (1)")


def main(options: argparse.Namespace) -> int:
    from rig.files.configuration import read_configuration

    require("emulate")
    if not 1e-6 <= options.speed <= FASTEST:
        raise fault("--speed", repr(options.speed), f"expected a number from 1e-6 to {FASTEST:g}")
    file = read_configuration(options.config, for_experiment=False)
    from rig.bench.assembly import emulated_instruments
    from rig.ports.pseudo_terminal import PseudoTerminals
    from rig.safety.signals import SignalStop

    instruments = emulated_instruments(file, 0.0)
    with SignalStop(), PseudoTerminals({role: i for role, _, i in instruments}, speed=options.speed) as terminals:
        for role, name, _ in instruments:
            print(f"{role} {name} {terminals.paths[role]}", flush=True)
        while terminals.failure is None:
            time.sleep(0.2)
        raise terminals.failure
