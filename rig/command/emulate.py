"""peltier emulate CONFIG [--speed X]: the simulated instruments on pseudo-terminals, until stopped.

Prints a line an instrument, `controller meerstetter /dev/pts/3`, and nothing else on stdout; then serves in real time
(times X). The instruments share one plant.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from rig.faults import fault


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="times real time (1)")


def main(options: argparse.Namespace) -> int:
    from rig.files.configuration import read_configuration

    if not options.speed > 0.0:
        raise fault("--speed", repr(options.speed), "expected a number > 0")
    file = read_configuration(options.config)
    from rig.bench import emulated_instruments
    from rig.ports.pseudo_terminal import PseudoTerminals
    from rig.safety.signals import SignalStop

    instruments = emulated_instruments(file, 0.0)
    with SignalStop(), PseudoTerminals({role: i for role, _, i in instruments}, speed=options.speed) as terminals:
        for role, name, _ in instruments:
            print(f"{role} {name} {terminals.paths[role]}", flush=True)
        while terminals.failure is None:
            time.sleep(0.2)
        raise terminals.failure
