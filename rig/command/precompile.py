"""peltier precompile: compile ahead what would be compiled at its first use.

The control law and the simulated plate, and the loops of identify, predict, invert and diagnose, which are used on a
simulated record for that. The compiled loops are kept on disk; the first command after a set-up or an update then
begins at once. `./peltier` does this in the background after a set-up.
"""

from __future__ import annotations

import argparse


def arguments(parser: argparse.ArgumentParser) -> None:
    """None."""


def main(options: argparse.Namespace) -> int:
    import time

    from compensator.precompile import precompile
    from rig.rehearsal.precompiled import precompile as precompile_analysis

    began_s = time.monotonic()
    precompile()
    print(f"control law: compiled in {time.monotonic() - began_s:.1f} s", flush=True)
    precompile_analysis()
    print(f"all: compiled in {time.monotonic() - began_s:.1f} s")
    return 0
