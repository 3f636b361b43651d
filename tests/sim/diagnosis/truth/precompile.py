"""Compiles the generator's loops ahead: each process of the tests would compile them for itself."""

from __future__ import annotations

import numpy as np

from tests.sim.diagnosis.truth.draw import draw_bench, draw_film
from tests.sim.diagnosis.truth.readings import lagged
from tests.sim.diagnosis.truth.rig import simulate


def precompile() -> None:
    """A film's path, a rig's record in a closed and in an open loop, and an ohmmeter's lag."""
    random = np.random.default_rng(0)
    draw_film(random, "of_class", form=0).log_ohm(np.array([30.0, 60.0]))
    bench = draw_bench(random, rows=100)
    simulate(bench.rig, bench.schedule)
    lagged(np.arange(3.0), np.zeros(3), 1.0)
