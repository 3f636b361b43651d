"""Predictions of film records that lack rows: what the film remembers after a gap."""

from __future__ import annotations

import pytest

import rig
from rig.config.model_file import Model
from rig.records.conversion import record_from_arrays
from tests.sim.inference.identification_films import is_prandtl_ishlinskii
from tests.sim.inference.test_identify_gaps import NOISE, with_an_excursion


@pytest.mark.parametrize(("to_degC", "less"), [(86.0, 0.3), (None, 1.02)])
def test_the_first_rows_after_a_gap_tell_what_the_film_went_through(to_degC: float | None, less: float) -> None:
    time, v, y = with_an_excursion(to_degC)
    record = record_from_arrays({"time_s": time, "temperature_degC": v, "resistance_ohm": 10.0**-y})
    model = Model(is_prandtl_ishlinskii(1), None)
    straight = rig.predict(model, record, initial="cooled")
    assert any("1 gap in which the temperature is unknown, the longest of 200 s" in note for note in straight.notes)
    fitted = rig.predict(model, record, initial="fitted")
    assert fitted.rmse_dec is not None
    assert straight.rmse_dec is not None
    assert fitted.rmse_dec < less * straight.rmse_dec
    went = "no excursion" if to_degC is None else "as if the temperature had gone to"
    assert any(went in note for note in fitted.notes)
    if to_degC is None:
        assert fitted.rmse_dec == pytest.approx(NOISE, rel=0.1)


def test_a_record_without_gaps_has_no_note() -> None:
    time, v, y = (column[:800] for column in with_an_excursion(None))
    record = record_from_arrays({"time_s": time, "temperature_degC": v, "resistance_ohm": 10.0**-y})
    assert rig.predict(Model(is_prandtl_ishlinskii(1), None), record).notes == ()
