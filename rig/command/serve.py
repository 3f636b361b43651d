"""peltier serve CONFIG: the bench daemon. Holds the instruments, runs experiments, keeps history, shows a page.

It starts with the output commanded off; nothing resumes by itself. `peltier status`, `watch`, `stop`, `off`, `reset`
and `peltier run` talk to it. Ends on INT, TERM, HUP or QUIT with the output off. More is in docs/daemon.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.core.requirements import require
from rig.guard.pipe import Guard
from rig.guard.process import guarded_where_needed


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="configuration of the bench (TOML), with [serve]")
    parser.add_argument("--address", metavar="A", help="address to listen at, in place of serve.address")
    parser.add_argument("--port", type=int, metavar="N", help="TCP port, in place of serve.port; 0: any that is free")


def main(options: argparse.Namespace) -> int:
    require("serve")
    return guarded_where_needed(options.config, options.own_process, lambda guard: _serve(options, guard))


def _serve(options: argparse.Namespace, guard: Guard) -> int:
    """Run the bench process: the guard's child if ports are real."""
    from rig.config.configuration import read_configuration
    from rig.daemon.serving import bench_of, serve

    file, notes = bench_of(read_configuration(options.config, for_experiment=False), options.address, options.port)
    return serve(file, notes, guard)
