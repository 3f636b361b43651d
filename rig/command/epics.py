"""peltier epics CONFIG: an EPICS server for the bench daemon: readings, state, trips, STOP.

It listens as [epics] says, on Channel Access and PV Access, and asks the daemon of serve.name; it holds no instrument.
Records that start and reset exist only with [epics] write = true. More is in docs/epics.md. Ends on a signal; the bench
goes on.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.core.requirements import require


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="configuration of the bench (TOML), with [epics]")


def main(options: argparse.Namespace) -> int:
    require("epics")
    from rig.config.configuration import read_configuration
    from rig.daemon.client import socket_of
    from rig.epics.serving import serve

    file = read_configuration(options.config, for_experiment=False)
    name = file.content.serve.name
    return serve(file, lambda: socket_of(name), lambda line: print(line, flush=True))
