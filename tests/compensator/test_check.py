"""`check_model` finds what physics.md says of the paper's models, and nothing wrong with a sound one."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memoryless
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
    found = check_model(model, 20.0, 100.0)
    order = next(f for f in found.findings if f.kind == "order")
    assert found.least_radius[0] == pytest.approx(radius, abs=1e-3)
    assert len(order.operators) == violating
    assert np.all(found.order_margin[list(order.operators)] < 0.0)
    np.testing.assert_allclose(found.order_margin, model.order_margin(20.0, 100.0), atol=1e-6)


def test_the_smallest_allowed_radius_keeps_the_order_and_no_smaller_one_does() -> None:
    model = table_2(generalized=False)
    least = float(check_model(model, 20.0, 100.0).least_radius[0])
    for radius, fine in ((least + 1e-4, True), (least - 1e-4, False)):
        single = FilmModel(np.array([radius]), np.ones(1), model.rising, model.falling)
        assert ("order" not in check_model(single, 20.0, 100.0).kinds()) == fine
        memory = single.simulate(np.array([99.0, 61.428]), single.initial_memory(20.0, "heated"))[1]
        jump = single.step(61.428 + 1e-9, memory)[0] - single.output_at(memory)
        assert (jump < 1e-6) == fine


def test_table_1_is_not_monotone_and_table_2_has_no_p_r0() -> None:
    table = check_model(table_1(generalized=False), 20.0, 80.0)
    assert "not_monotone" in table.kinds()
    assert "iteration" in table.kinds()
    assert "iteration_undefined" in check_model(table_2(generalized=False), 20.0, 100.0).kinds()


def test_the_contraction_factor_and_its_error_bound() -> None:
    """Section 5.1: q = 5/6, the error at sigma is up to five sigma; with D = -8 v nothing contracts."""
    model = FilmModel([0.0, 0.5], [6.0, 1.0], IDENTITY, IDENTITY, Memoryless("cos", 5.0), "classical_pi")  # type: ignore[arg-type]
    contraction = check_model(model, -10.0, 10.0).contraction
    assert contraction.q == pytest.approx(5.0 / 6.0, rel=1e-6)
    assert contraction.error_bound_K(1e-4) == pytest.approx(5e-4, rel=1e-5)
    falling = FilmModel([0.0, 0.5], [6.0, 1.0], IDENTITY, IDENTITY, Memoryless("linear", -8.0), "classical_pi")  # type: ignore[arg-type]
    assert check_model(falling, -10.0, 10.0).contraction.q == pytest.approx(8.0 / 6.0)


def test_a_flat_interval_is_where_nothing_moves() -> None:
    envelope = Envelope("tanh", 0.2, -12.0), Envelope("tanh", 0.2, -11.6)
    model = FilmModel(np.array([0.1, 0.2]), np.ones(2), *envelope, Memoryless("none"))
    still = next(f for f in check_model(model, 40.0, 80.0).findings if f.kind == "stands_still")
    assert still.where_degC is not None
    low, high = still.where_degC
    memory = model.simulate(np.array([high]), model.initial_memory(40.0, "heated"))[1]
    inside = model.simulate(np.linspace(high, low + 1e-6, 20), memory)[0]
    assert np.ptp(inside) <= 1e-12


def test_the_reachable_range_is_that_of_the_major_loop() -> None:
    model = table_2(generalized=False)
    low, high = check_model(model, 20.0, 100.0).output_range
    loop = np.concatenate([np.linspace(20.0, 100.0, 400), np.linspace(100.0, 20.0, 400)[1:]])
    outputs, _ = model.simulate(loop, model.initial_memory(20.0, "heated"))
    assert low == pytest.approx(outputs.min(), abs=1e-6)
    assert high == pytest.approx(outputs.max(), abs=1e-6)


def test_a_sound_model_has_no_findings_but_its_dead_band() -> None:
    envelope = Envelope("tanh", 0.2, -12.0)
    model = FilmModel(np.array([0.0, 0.1]), np.ones(2), envelope, envelope, Memoryless("none"))
    assert check_model(model, 50.0, 70.0).findings == ()
