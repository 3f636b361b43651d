"""One chain: a model simulated, fitted, predicted and observed.

    ./peltier benchmark chain [--triples 300]

Random sets of three effects in random order, by the simulated rig, the fits' forward model, `predict` and the observer,
noise-free on the same nodes (`tests.sim.four_ways`): the largest difference in kelvin and decades.
"""

from __future__ import annotations

import random
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._harness import options

ASKED = 1e-6  # K and decades


def main() -> int:
    from tests.sim.four_ways import differences, every_effect, on

    count = options(__doc__, triples=300).triples
    rng, worst = random.Random(0), {}
    for _ in range(count):
        for way, (off_K, off_dec) in differences(tuple(on(e) for e in rng.sample(every_effect(), 3))).items():
            known = worst.get(way, (0.0, 0.0))
            worst[way] = max(known[0], off_K), max(known[1], off_dec)
    for way, (off_K, off_dec) in worst.items():
        found = f"{count} triples: {off_K:.1e} K, {off_dec:.1e} dec"
        print(f"{way:<10} against the simulated rig, {found}   asked {ASKED:g}")
    return int(max(map(max, worst.values())) > ASKED)


if __name__ == "__main__":
    sys.exit(main())
