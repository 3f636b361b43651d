"""Functions of a user's own, registered in one place, in the same compiled loops."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.hysteresis.own_functions import register_envelope, register_memoryless
from compensator.inverse.inverse import Inverse
from tests.compensator.film_models import damped_path

NOTHING = str.upper  # a Python object that numba cannot compile into machine code


def register() -> None:
    register_envelope(
        "arctan",
        value=lambda s: math.atan(s),
        slope=lambda s: 1.0 / (1.0 + s * s),
        inverse=lambda y: math.tan(y),
        low=-0.5 * math.pi,
        high=0.5 * math.pi,
        inflection=0.0,
    )
    register_memoryless(
        "gauss",
        value=lambda s: math.exp(-s * s),
        slope=lambda s: -2.0 * s * math.exp(-s * s),
        curvature=lambda s: (4.0 * s * s - 2.0) * math.exp(-s * s),
    )
    register_memoryless(
        "called_back",
        value=lambda s: math.sin(s) + 0.0 * len(NOTHING("a")),
        slope=lambda s: math.cos(s) + 0.0 * len(NOTHING("a")),
        curvature=lambda s: -math.sin(s) + 0.0 * len(NOTHING("a")),
    )


def model(memoryless: str) -> FilmModel:
    register()
    count = 8
    return FilmModel(
        np.linspace(0.2, 1.5, count),
        np.full(count, 0.2),
        Envelope("arctan", 0.3, -18.6),
        Envelope("arctan", 0.3, -17.9),
        Memoryless(memoryless, 0.7, 0.15, -9.0, -3.0),
    )


@pytest.mark.parametrize("memoryless", ["gauss", "called_back"])
def test_model_and_inverse_work_as_with_built_in_functions(memoryless: str) -> None:
    film = model(memoryless)
    inverse = Inverse(film)
    rng = np.random.default_rng(2)
    path = damped_path(rng, 60)
    memory = film.initial_memory(float(path[0]))
    for v in path:
        target = film.step(float(v), memory)[0]
        s = 0.15 * v - 9.0
        d = 0.7 * (math.exp(-s * s) if memoryless == "gauss" else math.sin(s)) - 3.0
        plays = film.step(float(v), memory)[1].plays
        assert target == pytest.approx(d + float(film.weights @ plays), abs=1e-12)
        solution = inverse.solve(target, memory)
        assert solution.reachable
        assert abs(solution.residual) <= inverse.bound
        memory = film.step(float(v), memory)[1]


def test_a_pickled_model_looks_its_functions_up_again() -> None:
    film = model("gauss")
    assert film.packed is not None  # cached, with addresses that hold in this process only
    copy = pickle.loads(pickle.dumps(film))
    assert "packed" not in copy.__dict__
    path = np.linspace(30.0, 90.0, 20)
    assert np.array_equal(
        copy.simulate(path, copy.initial_memory(30.0))[0], film.simulate(path, film.initial_memory(30.0))[0]
    )


def test_functions_that_contradict_one_another_are_refused() -> None:
    with pytest.raises(ValueError, match="inverse"):
        register_envelope("bad", lambda s: s, lambda s: 1.0, lambda y: y + 1.0)
    with pytest.raises(ValueError, match="decreases"):
        register_envelope("bad", lambda s: -s, lambda s: -1.0, lambda y: -y)
    with pytest.raises(ValueError, match="difference quotient"):
        register_memoryless("bad", lambda s: s * s, lambda s: s, lambda s: 2.0)
