"""`check_model` finds what is wrong with the paper's models, and nothing with a sound one."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.inverse.check import check_model
from tests.compensator.film_models import table_1, table_2


@pytest.mark.parametrize(
    ("model", "radius", "violating"),
    [
        (table_2(generalized=False), 0.517, 15),
        (table_1(generalized=False), 0.179, 3),
        (table_2(generalized=True), 0.109, 3),
    ],
)
def test_the_smallest_allowed_radii_of_the_paper_s_tables(model: FilmModel, radius: float, violating: int) -> None:
    order = next(f for f in check_model(model, 20.0, 100.0) if f.kind == "order")
    assert len(order.operators) == violating
    assert order.advice.startswith(f"use radii from {radius:.3f} on")


@pytest.mark.parametrize(("off", "fine"), [(1e-4, True), (-1e-4, False)])
def test_the_smallest_allowed_radius_keeps_the_order_and_no_smaller_one_does(off: float, fine: bool) -> None:
    model = table_2(generalized=False)
    least = float((model.radii - 0.5 * model.order_margin(20.0, 100.0))[0])
    single = FilmModel(np.array([least + off]), np.ones(1), model.rising, model.falling)
    assert all(f.kind != "order" for f in check_model(single, 20.0, 100.0)) == fine
    memory = single.simulate(np.array([99.0, 61.428]), single.initial_memory(20.0, "heated"))[1]
    jump = single.step(61.428 + 1e-9, memory)[0] - single.output_at(memory)
    assert (jump < 1e-6) == fine


def test_table_1_is_not_monotone() -> None:
    assert "not_monotone" in [f.kind for f in check_model(table_1(generalized=False), 20.0, 80.0)]


def test_a_flat_interval_is_where_nothing_moves() -> None:
    envelope = Envelope("tanh", 0.2, -12.0), Envelope("tanh", 0.2, -11.6)
    model = FilmModel(np.array([0.1, 0.2]), np.ones(2), *envelope, Memoryless("none"))
    still = next(f for f in check_model(model, 40.0, 80.0) if f.kind == "stands_still")
    assert still.where_degC is not None
    assert "D(T)" not in still.what  # this film has none, and whoever reads of it looks for it in vain
    low, high = still.where_degC
    memory = model.simulate(np.array([high]), model.initial_memory(40.0, "heated"))[1]
    inside = model.simulate(np.linspace(high, low + 1e-6, 20), memory)[0]
    assert np.ptp(inside) <= 1e-12


def test_a_sound_model_has_no_findings() -> None:
    envelope = Envelope("tanh", 0.2, -12.0)
    model = FilmModel(np.array([0.0, 0.1]), np.ones(2), envelope, envelope, Memoryless("none"))
    assert check_model(model, 50.0, 70.0) == ()
