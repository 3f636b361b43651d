"""Numbers and sentences of a diagnosis, and what is told of its records, as people read them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.figure import Figure

from rig.records.record_file import write_columns
from rig.report.diagnosis import _against, _times_of_each
from rig.report.diagnosis_words import candidate_set, parameter, residual_words, sentence, verdict_words
from sim.diagnosis.result import Candidate, Caution, Channel, Finding, rough
from sim.inference.gain import Gain
from sim.inference.record.joined import read_records
from sim.inference.record.quantity import FALLING_OHM, RESISTANCE
from tests.peltier import Peltier
from tests.sim.diagnosis.plate_record import levels, record

LOSS = "radiative_loss (radiated power over (heat capacity T\N{SUPERSCRIPT FOUR}) 2e-11 1/(K\N{SUPERSCRIPT THREE} s))"


@pytest.mark.parametrize(
    ("value", "said"),
    [(0.0621, "0.062"), (2.44, "2.4"), (99.7, "100"), (230.4, "230"), (-1234.0, "-1,200"), (4.7e6, "4,700,000")],
)
def test_two_digits_have_no_exponent(value: float, said: str) -> None:
    assert rough(value) == said


def test_an_interval_that_says_nothing_more_is_told_by_its_digits() -> None:
    assert parameter("step_K", 0.25, (0.25 - 2.5e-7, 0.25 + 2.5e-7)) == "step 0.25 K (to 6 digits)"
    assert parameter("tau_s", 2.27, (2.25, 2.29)) == "time constant 2.27 s (2.25 to 2.29)"


@pytest.mark.parametrize(
    ("named", "said"),
    [
        (set(), "sensor_lag (time constant 30 s); " + LOSS),
        (
            {"sensor_lag"},
            LOSS + ", together with sensor_lag",
        ),
        (
            {"actuator_delay"},
            "sensor_lag (time constant 30 s); " + LOSS + ", without actuator_delay",
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
        drive=None,
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
        drive=None,
    )  # fmt: skip
    assert sentence(found).startswith("The extended model predicts the held-out record worse than the base model")


def found_nothing(verdict: str, *codes: str, error_K: float = 0.62) -> Any:
    """A diagnosis without effects or structure; error_K: of held-out temperatures, at a noise of 0.134 K."""
    return SimpleNamespace(
        verdict=verdict, findings=(), warnings=tuple(Caution(code, f"the {code}") for code in codes), limits=(),
        written="extended", unexplained={}, elsewhere=(), sources=("a.csv",), drive=None,
        channels={"temperature_K": Channel(0.134, error_K, error_K, 18)},
        record=SimpleNamespace(quantity=RESISTANCE), search=SimpleNamespace(known={}),
    )  # fmt: skip


@pytest.mark.parametrize("codes", [(), ("out_of_time",), ("current_between_rows",)])
def test_a_model_that_is_off_is_nowhere_said_to_leave_noise(codes: tuple[str, ...]) -> None:
    """Else whoever reads one sentence uses the model, and whoever reads the other does not."""
    found = found_nothing("too_short" if "out_of_time" in codes else "clean", *codes)
    for text in (sentence(found), residual_words(found)):
        assert "is noise" not in text
        assert "Clean" not in text
        assert "temperature by 4.6 times its noise" in text
    assert verdict_words(found) == ("not decided" if "out_of_time" in codes else "no effect seen")
    assert ("because the current changed between the rows" in sentence(found)) == ("current_between_rows" in codes)


def test_a_search_that_the_budget_ended_says_so_first_and_clears_no_rig() -> None:
    """Else effects that were never tried are taken for excluded."""
    said = sentence(found_nothing("too_short", "out_of_time", error_K=0.135))
    assert said == "The out_of_time. Not decided: no effect was found until then."
    assert sentence(found_nothing("clean", error_K=0.135)) == "Clean: no effect is seen, and the residual is noise."


ROOMS_DEGC = {"one": 21.0, "two": 27.0, "three": 24.0, "four": 23.0}
ROW = np.arange(100.0)


def two_records() -> SimpleNamespace:
    """A plate that cools by 0.1 K/s from 60 degC, twice; the second begins at 1000 s."""
    columns = {"temperature_degC": 60.0 - 0.1 * ROW, "current_A": np.where(ROW < 50, -1.0, -0.5)}
    records = [{"time_s": begin + ROW, **columns} for begin in (0.0, 1000.0)]
    return SimpleNamespace(record=read_records(records, FALLING_OHM, held_out=False), plate=None, drive=None)


def test_no_rate_is_taken_from_one_record_to_the_next() -> None:
    shown = dict(_against(two_records()))  # type: ignore[arg-type]
    assert shown["rate / K/s"] == pytest.approx(np.full(200, -0.1), abs=0.06)


def test_an_axis_has_the_times_of_each_file() -> None:
    axis = Figure().subplots()
    _times_of_each(axis, two_records().record)
    told = [float(label.get_text()) for label in axis.get_xticklabels()]
    assert min(told) == 0.0
    assert max(told) > 1050.0
    assert axis.get_xticks() == pytest.approx([t if t < 100.0 else t - 1000.0 + 99.0 + 60.0 for t in told])


def test_records_as_one_and_those_held_out_are_each_told(tmp_path: Path, peltier: Peltier) -> None:
    one, two, *others = [tmp_path / f"{name}.csv" for name in ROOMS_DEGC]
    for seed, (name, room) in enumerate(ROOMS_DEGC.items(), 5):
        write_columns(tmp_path / f"{name}.csv", record(room, levels(seed, 10), seed))
    words = ["--joint", "--budget", "5", "--report", tmp_path / "report", "--json", tmp_path / "said.json"]
    words += [word for path in others for word in ("--holdout", path)]
    out = peltier.succeeds("diagnose", one, two, *words)
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    said = json.loads((tmp_path / "said.json").read_text())
    assert "Diagnosis of one.csv and two.csv" in page
    rows = [f"{name}.csv: 200 rows over 199 s, one every 1 s" for name in ("one", "two")]
    assert [found["source"] for found in said["holdouts"]] == [str(path) for path in others]
    errors = [found["channels"]["temperature_K"] for found in said["holdouts"]]
    held = [f"{path.name}: temperature {e['rmse_extended']:.4g} K" for path, e in zip(others, errors, strict=True)]
    assert [found["ambient_degC"] for found in said["holdouts"]] == pytest.approx([24.0, 23.0], abs=0.3)
    held += [f"room {found['ambient_degC']:.4g} \N{DEGREE SIGN}C" for found in said["holdouts"]]
    rooms = ", ".join(f"{Path(r['source']).name} {r['ambient_degC']:.4g} \N{DEGREE SIGN}C" for r in said["records"])
    for text in (*rows, *held, rooms):
        assert text in page
        assert text in out
    whole = said["channels"]["temperature_K"]
    assert sum(e["samples_holdout"] for e in errors) == whole["samples_holdout"]
    square = sum(e["samples_holdout"] * e["rmse_extended"] ** 2 for e in errors) / whole["samples_holdout"]
    assert square**0.5 == pytest.approx(whole["rmse_extended"])
