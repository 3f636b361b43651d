"""Fits of both ends as a chain that runs over records (`sim.inference.nuisance.Forward`), the film in its own terms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_equations import FilmEquations
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.fit.temperature_channel import TemperatureFit
from sim.model.links import Links, links_of
from sim.model.plate_path import PlatePath, PlateRun
from sim.model.record_own import RecordOwn
from sim.model.record_run import run_plate
from sim.model.recorded import COARSE, Recorded, Spacing

MOST_ROUNDS = 30  # of a film that its own resistance heats: each leaves a tenth of the one before, or less
SAME_DEC = 1e-7  # from round to round


@dataclass(frozen=True, eq=False)
class FittedChain:
    """The fits of both ends as a chain that runs over a record, its film in the fit's own terms. last: the equations of
    b over that record (`FilmEquations.elsewhere`); spacing: of the plate's nodes."""

    a: TemperatureFit | None
    b: ResistanceFit | None
    last: FilmEquations | None
    spacing: Spacing = COARSE

    @property
    def links(self) -> Links:
        """All effects, in the chain's order."""
        return links_of([e for fit in (self.a, self.b) if fit is not None for e in fit.effects])

    @property
    def ambient_degC(self) -> float:
        """The room of the record that was fitted; of several the mean."""
        return self.a.parameters.usual_room_degC if self.a is not None else 0.0

    def plate(self, record: Recorded, own: RecordOwn) -> PlateRun:
        """As `sim.model.record_run.RecordRun.plate`."""
        assert self.a is not None
        links, p = links_of(self.a.effects), self.a.parameters
        return run_plate(record, links, p.numbers(), own, self.spacing, p.inputs_K_per_s)

    def shown(self, record: Recorded, path: PlatePath, own: RecordOwn) -> Array:
        """-log10 of the resistance shown in each row, with the fit's coefficients."""
        assert self.b is not None
        assert self.last is not None
        channel, p = self.last.on(path), _began(self.b.parameters, own)
        shown, film_output = channel.predict_from(p, self.b, own.late)
        if links_of(p.effects).heated and record.test_current_A is not None:
            for _ in range(MOST_ROUNDS):  # from the second on the model's own resistance heats the film
                before = film_output
                shown, film_output = channel.predict_from(replace(p, film_output=before), self.b, own.late)
                if float(np.max(np.abs(film_output - before))) < SAME_DEC:
                    break
        return shown


def _began(p: FilmParameters, own: RecordOwn) -> FilmParameters:
    """With the record's own memory, and what its filters are behind by."""
    lags = links_of(p.effects).film_lags
    x = p.x.copy()
    x[x.size - len(lags) :] = [own.late.get(e.name, 0.0) for e in lags]
    return replace(p, x=x, start=own.film, film_output=None)
