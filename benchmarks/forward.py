"""How fast the model runs, against C++ in the same run on the same samples.

    ./peltier benchmark forward [--json FILE]

Asked, with 30 operators on one core: at least 0.7 of the speed of the same recursion in C++ (g++ -O3, with and without
-march=native). No installable package runs a Preisach or Prandtl-Ishlinskii model that could stand beside them.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._harness import kept, options
from compensator.hysteresis.film import Envelope, FilmModel, Memoryless

SAMPLES, ROUNDS, OPERATORS = 1_000_000, 7, 30
SOURCE = r"""
#include <algorithm>
#include <cmath>
extern "C" void run(const double* v, long samples, double before, double* w, const double* r, const double* p,
                    long count, const double* e, const double* d, double* out) {
    for (long i = 0; i < samples; ++i) {
        const double x = v[i];
        if (x > before) {
            const double g = std::tanh(e[0] * x + e[1]);
            for (long j = 0; j < count; ++j) w[j] = std::max(g - r[j], w[j]);
        } else if (x < before) {
            const double g = std::tanh(e[2] * x + e[3]);
            for (long j = 0; j < count; ++j) w[j] = std::min(g + r[j], w[j]);
        }
        double u = d[0] * std::tanh(d[1] * x + d[2]) + d[3];
        for (long j = 0; j < count; ++j) u += p[j] * w[j];
        out[i] = u;
        before = x;
    }
}
"""
RISING, FALLING = Envelope("tanh", 0.2, -11.6), Envelope("tanh", 0.2, -11.0)
D = Memoryless("tanh", 0.4, 0.03, -1.6, -3.26)


def film() -> FilmModel:
    """Table 2's sizes; equal weights are a choice, the paper's are not in its text."""
    return FilmModel(np.arange(1, OPERATORS + 1) / OPERATORS, np.full(OPERATORS, 0.05), RISING, FALLING, D)


def smooth_path(samples: int) -> np.ndarray:
    """Damped oscillations through the transition."""
    t = np.linspace(0.0, 1.0, samples)
    return np.asarray(57.0 + 20.0 * (1.0 - t) * np.sin(2e-4 * samples * t))


def cpp(flags: list[str], folder: Path) -> Callable[[np.ndarray], np.ndarray]:
    """The recursion, compiled by g++ with these flags."""
    name = "run" + "".join(flags).replace("=", "_")
    source, library = folder / f"{name}.cpp", folder / f"{name}.so"
    source.write_text(SOURCE)
    subprocess.run(["g++", *flags, "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    function = ctypes.CDLL(str(library)).run

    def call(v: np.ndarray) -> np.ndarray:
        model, out = film(), np.empty(v.size)
        arrays = [
            model.initial_memory(float(v[0])).plays.copy(),
            model.radii,
            model.weights,
            np.array([RISING.a, RISING.b, FALLING.a, FALLING.b]),
            np.array([D.amplitude, D.a, D.b, D.offset]),
        ]
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (v, *arrays, out)]
        first = ctypes.c_long(v.size), ctypes.c_double(v[0])
        function(pointers[0], *first, *pointers[1:4], ctypes.c_long(OPERATORS), *pointers[4:])
        return out

    return call


def ours(v: np.ndarray) -> np.ndarray:
    """`FilmModel.simulate`."""
    model = film()
    return model.simulate(v, model.initial_memory(float(v[0])))[0]


def best_ns(functions: dict[str, Callable[[np.ndarray], np.ndarray]], v: np.ndarray) -> dict[str, float]:
    """Best time per sample (ns) of several rounds, the functions in turn."""
    best = dict.fromkeys(functions, float("inf"))
    for _ in range(ROUNDS):
        for name, function in functions.items():
            start = time.perf_counter()
            function(v)
            best[name] = min(best[name], (time.perf_counter() - start) / v.size * 1e9)
    return best


def main() -> int:
    asked = options(__doc__)
    v = smooth_path(SAMPLES)
    reference = ours(v)
    with tempfile.TemporaryDirectory() as folder:
        functions = {
            "ours": ours,
            "g++ -O3": cpp(["-O3"], Path(folder)),
            "g++ -O3 -march=native": cpp(["-O3", "-march=native"], Path(folder)),
        }
        for name, function in functions.items():
            assert np.abs(function(v) - reference).max() < 1e-12, name
        times = best_ns(functions, v)
    figures = {
        "ours_ns": times["ours"],
        "speed_of_gpp_O3": times["g++ -O3"] / times["ours"],
        "speed_of_gpp_O3_native": times["g++ -O3 -march=native"] / times["ours"],
    }
    print(f"model, {OPERATORS} operators                    {figures['ours_ns']:8.1f} ns a sample")
    print(f"speed, of g++ -O3                     {figures['speed_of_gpp_O3']:8.2f}    asked >= 0.7")
    print(f"speed, of g++ -O3 -march=native       {figures['speed_of_gpp_O3_native']:8.2f}    asked >= 0.7")
    kept(asked.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
