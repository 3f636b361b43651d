"""peltier precompile: compile ahead what the control law and the simulated plate would compile at their first use.

The compiled loops are cached; the first run after a set-up or an update begins at once. `./peltier` does this in the
background after a set-up.
"""

from __future__ import annotations

import argparse


def arguments(parser: argparse.ArgumentParser) -> None:
    """None."""


def main(options: argparse.Namespace) -> int:
    import time

    from compensator.precompile import precompile

    began_s = time.monotonic()
    precompile()
    print(f"compiled in {time.monotonic() - began_s:.1f} s")
    return 0
