"""Verbs that serve until they are stopped: the bench daemon, its EPICS server, the page of several benches."""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.core.requirements import require
from rig.guard.pipe import Guard
from rig.guard.process import guarded_where_needed


def serve_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="configuration of the bench (TOML), with [serve]")
    parser.add_argument("--address", metavar="A", help="address to listen at, in place of serve.address")
    parser.add_argument("--port", type=int, metavar="N", help="TCP port, in place of serve.port; 0: any that is free")


def serve(options: argparse.Namespace) -> int:
    """peltier serve CONFIG: the bench daemon. Holds the instruments, runs experiments, keeps history, shows a page.

    It starts with the output commanded off; nothing resumes by itself. `peltier status`, `watch`, `stop`, `off`,
    `reset` and `peltier run` talk to it. Ends on INT, TERM, HUP or QUIT with the output off. More is in docs/daemon.md.
    """
    require("serve")
    return guarded_where_needed(options.config, options.own_process, lambda guard: _serve(options, guard))


def _serve(options: argparse.Namespace, guard: Guard) -> int:
    """Run the bench process: the guard's child if ports are real."""
    from rig.config.configuration import read_configuration
    from rig.daemon.serving import bench_of, serve

    file, notes = bench_of(read_configuration(options.config, for_experiment=False), options.address, options.port)
    return serve(file, notes, guard)


def epics_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="configuration of the bench (TOML), with [epics]")


def epics(options: argparse.Namespace) -> int:
    """peltier epics CONFIG: an EPICS server for the bench daemon: readings, state, trips, STOP.

    It listens as [epics] says, on Channel Access and PV Access, and asks the daemon of serve.name; it holds no
    instrument. Records that start and reset exist only with [epics] write = true. More is in docs/epics.md. Ends on a
    signal; the bench goes on.
    """
    require("epics")
    from rig.config.configuration import read_configuration
    from rig.daemon.client import socket_of
    from rig.epics.serving import serve

    file = read_configuration(options.config, for_experiment=False)
    name = file.content.serve.name
    serve(file, lambda: Path(socket_of(name)), lambda line: print(line, flush=True))


def overview_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="which benches (TOML), with [overview] and [[bench]]")


def overview(options: argparse.Namespace) -> int:
    """peltier overview CONFIG: one page for several bench daemons, with a STOP for each.

    CONFIG (TOML) has [overview] and a [[bench]] with name, address and token for each daemon; more is in
    docs/daemon.md. It holds no instrument and no bench waits for it. Ends on a signal; the benches go on.
    """
    import asyncio

    from rig.overview import read_overview, serve

    content = read_overview(options.config)
    return asyncio.run(serve(content, lambda url: print(f"overview {url}", flush=True)))
