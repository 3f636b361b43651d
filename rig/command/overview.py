"""peltier overview CONFIG: one page for several bench daemons, with a STOP for each.

CONFIG (TOML) has [overview] and a [[bench]] with name, address and token for each daemon; more is in docs/daemon.md.
It holds no instrument and no bench waits for it. Ends on a signal; the benches go on.
"""

from __future__ import annotations

import argparse
from pathlib import Path


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, help="which benches (TOML), with [overview] and [[bench]]")


def main(options: argparse.Namespace) -> int:
    import asyncio

    from rig.overview import read_overview, serve

    content = read_overview(options.config)
    return asyncio.run(serve(content, lambda url: print(f"overview {url}", flush=True)))
