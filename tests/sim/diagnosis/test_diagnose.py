"""The diagnosis by one likelihood on records of a generator that shares no code with it."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.result import Diagnosis
from sim.inference.joint.channel_noise import noise_before_rounding, of_rounded
from sim.inference.joint.films import PreisachFilm
from tests.sim.diagnosis.cases import Case, case

ROWS = 3000


@cache
def made(kind: str, seed: int, **choice: Any) -> Case:
    return case(kind, seed, **choice)


def names(diagnosis: Diagnosis) -> list[str]:
    return [finding.name for finding in diagnosis.findings]


def test_a_clean_record_is_clean() -> None:
    """Else whoever has a good rig looks for a fault that is not there."""
    truth = made("clean", 5, rows=ROWS)
    diagnosis = diagnose(truth.columns)
    assert diagnosis.verdict == "clean"
    channel = diagnosis.channels["resistance_dec"]
    assert channel is not None
    assert channel.noise == pytest.approx(truth.noise["resistance_dec"], rel=0.1)
    assert channel.rmse_extended < 1.15 * channel.noise


@pytest.mark.parametrize("effect", ["film_lag", "series_resistance", "sensor_lag"])
def test_one_effect_is_named_with_its_size(effect: str) -> None:
    """Else a bench mends the wrong link, or the right one by the wrong amount."""
    truth = made("one", 11, effect=effect, rows=ROWS)
    diagnosis = diagnose(truth.columns)
    assert (diagnosis.verdict, names(diagnosis)) == ("explained", [effect])
    (parameter, value), *_ = truth.hidden[effect].items()
    size, interval = diagnosis.findings[0].parameters[parameter]
    assert interval is not None
    assert size == pytest.approx(value, rel=0.1)
    assert interval[1] - interval[0] < 0.5 * value
    gains = diagnosis.findings[0].gain
    assert any(gain.rmse_after < 0.9 * gain.rmse_before for gain in gains.values())


def test_a_record_without_a_film_tells_its_plate() -> None:
    """Else a plate record, which has no resistance, cannot be diagnosed."""
    truth = made("one", 3, effect="heat_sink_warmup", rows=ROWS)
    columns = {name: truth.columns[name] for name in ("time_s", "temperature_degC", "current_A")}
    diagnosis = diagnose(columns)
    assert names(diagnosis) == ["heat_sink_warmup"]
    assert diagnosis.channels["resistance_dec"] is None


def test_a_record_without_a_current_tells_its_film() -> None:
    """Else a film record, whose thermometer drives the film, cannot be diagnosed."""
    truth = made("one", 11, effect="film_lag", rows=ROWS)
    columns = {name: values for name, values in truth.columns.items() if name != "current_A"}
    assert names(diagnose(columns))[:1] == ["film_lag"]


def test_a_preisach_film_is_a_film_of_another_kind() -> None:
    """Else its ohmmeter is blamed for what the film does."""
    truth = made("other_film", 1000)
    diagnosis = diagnose(truth.columns)
    assert isinstance(diagnosis.fit.joint.film, PreisachFilm)
    assert not diagnosis.fit.effects


def test_a_drive_that_moves_nothing_is_said_so() -> None:
    """Else a loss or a lag is named of a plate that the logged drive does not even heat."""
    rng = np.random.default_rng(2)
    time = np.arange(1200) * 0.5
    columns = {
        "time_s": time,
        "temperature_degC": 60.0 + 20.0 * np.sin(time / 40.0) + 0.02 * rng.standard_normal(time.size),
        "current_A": np.repeat(rng.uniform(-2.0, 2.0, 60), 20),
    }
    diagnosis = diagnose(columns)
    assert "drive_without_effect" in {warning.code for warning in diagnosis.warnings}
    assert not {"radiative_loss", "heat_sink_warmup", "actuator_delay"} & set(names(diagnosis))


def test_rounded_readings_keep_the_noise_before_rounding() -> None:
    """Else a step of 0.25 K passes for noise of 0.07 K, and what is smaller is not seen."""
    rng = np.random.default_rng(1)
    shown = np.linspace(20.0, 60.0, 4000)
    readings = 0.25 * np.round((shown + 0.03 * rng.standard_normal(shown.size)) / 0.25)
    assert noise_before_rounding(readings - shown, 0.25) == pytest.approx(0.03, rel=0.2)


def test_the_likelihood_of_a_rounded_reading_and_its_slope() -> None:
    """Else a descent goes where the likelihood does not rise."""
    residual, step, white, by = np.array([-0.4, -0.1, 0.0, 0.05, 0.3, 2.0]), 0.25, 0.07, 1e-6
    more, less = (of_rounded(residual + side * by, step, white)[0] for side in (1.0, -1.0))
    _, mean, known = of_rounded(residual, step, white)
    np.testing.assert_allclose((more - less) / (2.0 * by), -mean / white, rtol=1e-4, atol=1e-4)
    assert np.all((known > 0.0) & (known <= 1.0))
