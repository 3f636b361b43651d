"""What one period of the whole control law costs, from Python, in a closed loop on a simulated plate and film.

    ./peltier benchmark law_step [--json FILE]

Asked of the law "full" with 30 operators and 8 previewed targets: a median of at most 25 us. The speed of the same
machine's model, a sample in ns, is told beside it to compare runs.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from benchmarks._harness import kept, options
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import NAMES, Inputs, LawName
from compensator.control.pid import PidGains
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import THIRTY_OPERATORS as FILM

STEPS, SAMPLES, ROUNDS = 3000, 200_000, 7


def model_ns() -> float:
    """Best time per sample of `FilmModel.simulate`, over damped oscillations through the transition."""
    t = np.linspace(0.0, 1.0, SAMPLES)
    path, best = 57.0 + 20.0 * (1.0 - t) * np.sin(2e-4 * SAMPLES * t), float("inf")
    for _ in range(ROUNDS):
        start = time.perf_counter()
        FILM.simulate(path, FILM.initial_memory(float(path[0])))
        best = min(best, time.perf_counter() - start)
    return best / SAMPLES * 1e9


def median_us(name: LawName) -> float:
    """Median time of `Law.step` over a closed loop of STEPS periods."""
    model, plate = FILM, PlateModel(1.6e-3, 0.06, 0.018, 25.0)
    gains = PidGains(8.0, 3.0, 2.0) if name == "pid" else PidGains(1.2, 0.3, 1.0)
    law = Law(LawSettings(name, 0.1, 4.0, 10.0, 95.0, gains), plate, None if name == "temperature" else model)
    memory, temperature, current = model.initial_memory(50.0), 50.0, 0.0
    state, ahead = law.start(50.0, None), law.preview_times_s()
    rng, times = np.random.default_rng(0), []
    for k in range(STEPS):
        now = 0.1 * k
        temperature = plate.step(temperature, current, 0.1)
        output, memory = model.step(temperature, memory)
        t = now + ahead
        targets = 60.0 + 8.0 * np.sin(0.3 * t) if name == "temperature" else -3.0 + 0.7 * np.sin(0.25 * t)
        readings = temperature + 0.01 * rng.normal(), output + 0.002 * rng.normal()
        start = time.perf_counter()
        command, state = law.step(state, Inputs(*readings, float(targets[0]), targets))
        times.append(time.perf_counter() - start)
        current = command.current_A
    return float(np.median(times)) * 1e6


def main() -> int:
    asked = options(__doc__)
    figures = {name: median_us(name) for name in NAMES}
    for name, microseconds in figures.items():
        limit = "    asked <= 25" if name == "full" else ""
        print(f"{name:16s} {microseconds:6.1f} us a step{limit}")
    figures["model_ns"] = model_ns()
    print(f"the model alone  {figures['model_ns']:6.1f} ns a sample")
    kept(asked.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
