"""Numbers and sentences of a diagnosis, as people read them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from rig.report.diagnosis_words import candidate_set, parameter, sentence
from sim.diagnosis.result import Candidate, Caution, Finding, rough
from sim.inference.gain import Gain
from sim.inference.record.quantity import RESISTANCE


@pytest.mark.parametrize(
    ("value", "said"),
    [(0.0621, "0.062"), (2.44, "2.4"), (99.7, "100"), (230.4, "230"), (-1234.0, "-1,200"), (4.7e6, "4,700,000")],
)
def test_two_digits_have_no_exponent(value: float, said: str) -> None:
    assert rough(value) == said


def test_an_interval_that_says_nothing_more_is_told_by_its_digits() -> None:
    assert parameter("step_K", 0.25, (0.25 - 2.5e-7, 0.25 + 2.5e-7)) == "step 0.25 K (to 6 digits)"
    assert parameter("tau_s", 2.27, (2.25, 2.29)) == "tau 2.27 s (2.25 to 2.29)"


@pytest.mark.parametrize(
    ("named", "said"),
    [
        (set(), "sensor_lag (tau 30 s); radiative_loss (loss 2e-11 1/(K\N{SUPERSCRIPT THREE} s))"),
        (
            {"sensor_lag"},
            "radiative_loss (loss 2e-11 1/(K\N{SUPERSCRIPT THREE} s)), together with sensor_lag (here tau 30 s)",
        ),
        (
            {"actuator_delay"},
            "sensor_lag (tau 30 s); radiative_loss (loss 2e-11 1/(K\N{SUPERSCRIPT THREE} s)), without actuator_delay",
        ),
    ],
)
def test_an_effect_that_is_named_is_not_called_unnamed(named: set[str], said: str) -> None:
    sizes: Any = {"sensor_lag": {"tau_s": (30.0, None)}, "radiative_loss": {"loss_per_K3_s": (2e-11, None)}}
    candidate = Candidate(tuple(sizes), sizes, {}, {}, {}, "", cast(Any, None))
    assert candidate_set(candidate, frozenset(named)) == said


def test_the_first_sentence_says_what_matters_most() -> None:
    """Else a saturated sink stands behind a rounding that gains nothing."""
    rounding = Finding("thermometer_quantization", {"step_K": (0.25, None)}, 900.0, 0.003)
    lag = Finding(
        "film_lag", {"tau_s": (2.0, (1.9, 2.1))}, 50.0, 0.003, gain={"resistance_dec": Gain(0.01, 0.002, (0.7, 0.9))}
    )
    sink = Caution("heat_sink_saturated", "the heat sink is saturated; more current cools less", 350.0, 500.0)
    found: Any = SimpleNamespace(
        verdict="explained", findings=(rounding, lag), warnings=(sink,), written="extended", unexplained={},
        channels={}, elsewhere=(), sources=("a.csv",), record=SimpleNamespace(quantity=RESISTANCE),
        search=SimpleNamespace(known={}),
    )  # fmt: skip
    said = sentence(found)
    places = [
        said.index(text) for text in ("The heat sink is saturated", "(from 350 to 500 s)", "film_lag", "quantization")
    ]
    assert places == sorted(places)


def test_a_model_that_predicts_worse_elsewhere_is_said_so_first() -> None:
    """Else a name that one record suggests passes for the rig's."""
    lag = Finding("film_lag", {"tau_s": (2.0, (1.9, 2.1))}, 50.0, 0.003)
    found: Any = SimpleNamespace(
        verdict="partly_unexplained", findings=(lag,), warnings=(), written="base", unexplained={}, channels={},
        elsewhere=(), sources=("a.csv",), record=SimpleNamespace(quantity=RESISTANCE), search=SimpleNamespace(known={}),
    )  # fmt: skip
    assert sentence(found).startswith("The extended model predicts the held-out record worse than the base model")
