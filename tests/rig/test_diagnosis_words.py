"""Numbers and sentences of a diagnosis, as people read them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rig.analysis.one_row import of_diagnosis
from rig.report.diagnosis import behind_the_verdict
from rig.report.diagnosis_lines import lines
from rig.report.diagnosis_words import candidate_set, parameter
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.report.candidates import Candidate
from sim.diagnosis.result import HeldOutRecord
from tests.diagnosis.plate_record import levels, record


@pytest.mark.parametrize(
    ("value", "said"),
    [(0.0621, "0.062"), (2.44, "2.4"), (99.7, "100"), (230.4, "230"), (-1234.0, "-1,200"), (4.7e6, "4,700,000")],
)
def test_two_digits_have_no_exponent(value: float, said: str) -> None:
    assert rough(value) == said


@pytest.mark.parametrize(
    ("behind", "said"),
    [(-0.0, "as good"), (0.04, "as good"), (-0.04, "as good"), (-2.1, "better by 2.1"), (7.0, "7.0")],
)
def test_nothing_is_better_by_nothing(behind: float, said: str) -> None:
    assert behind_the_verdict(behind) == said


def test_an_interval_that_says_nothing_more_is_told_by_its_digits() -> None:
    assert parameter("step_K", 0.25, (0.25 - 2.5e-7, 0.25 + 2.5e-7)) == "step_K 0.25 (to 6 digits)"
    assert parameter("tau_s", 2.27, (2.25, 2.29)) == "tau_s 2.27 (2.25 to 2.29)"


@pytest.mark.parametrize(
    ("named", "said"),
    [
        (set(), "sensor_lag (tau_s 30); radiative_loss (loss_per_K3_s 2e-11)"),
        ({"sensor_lag"}, "radiative_loss (loss_per_K3_s 2e-11), beside sensor_lag (named above, here with tau_s 30)"),
        ({"actuator_delay"}, "sensor_lag (tau_s 30); radiative_loss (loss_per_K3_s 2e-11), without actuator_delay"),
    ],
)
def test_an_effect_that_is_named_is_not_called_unnamed(named: set[str], said: str) -> None:
    sizes = {"sensor_lag": {"tau_s": 30.0}, "radiative_loss": {"loss_per_K3_s": 2e-11}}
    candidate = Candidate(tuple(sizes), sizes, {}, {}, {}, "")
    assert candidate_set(candidate, frozenset(named)) == said


def test_what_is_left_is_the_same_in_text_json_and_table() -> None:
    """Of a verdict that holds for the fitted rows, and not for another record."""
    clean = diagnose(record(24.0, levels(1, 10), 1))
    assert clean.document()["left"] == {"temperature_K": None, "resistance_dec": None}
    channel = clean.channels["temperature_K"]
    assert channel is not None
    missed = replace(channel, rmse_extended=2.4 * channel.expected, all_told=1.6)
    held = (HeldOutRecord("runs/other.csv", {"temperature_K": (missed.rmse_extended, 100)}),)
    found = replace(clean, channels={**clean.channels, "temperature_K": missed}, elsewhere=held)
    said, told = found.document(), lines(found)
    assert said["verdict"] == clean.verdict == "clean"
    assert said["unexplained"]["temperature_K"] is None
    left = said["left"]["temperature_K"]
    assert left.startswith("held-out rows are off by 2.4 times the noise")
    assert f"left: temperature: {left}" in told
    assert of_diagnosis(said)["left"] == f"temperature_K: {left}"
    assert "not for the held-out record other.csv: temperature is off by 2.4 times the noise there" in told[0]
