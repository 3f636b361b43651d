"""Fits of both ends as a chain that runs over records, `sim.model.own_fit.Forward`: the film in the fit's own terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.fit.temperature_channel import TemperatureFit
from sim.model.links import Links, links_of
from sim.model.plate_path import PlatePath, PlateRun
from sim.model.record_own import RecordOwn
from sim.model.record_run import run_plate
from sim.model.recorded import COARSE, Recorded, Spacing

MOST_ROUNDS = 30  # of a film that its own resistance heats: each leaves a tenth of the one before, or less
SAME_DEC = 1e-7  # from round to round


class FittedChain:
    """The fits of both ends as a chain that runs over another record, its film in the fit's own terms."""

    def __init__(
        self,
        a: TemperatureFit | None,
        b: ResistanceFit | None,
        last: ResistanceChannel | None,
        spacing: Spacing = COARSE,
    ) -> None:
        """last: the channel of b."""
        self.links: Links = links_of([*(a.effects if a else ()), *(b.effects if b else ())])
        self._first = links_of(a.effects) if a is not None else Links()
        self._a, self._b, self._last, self._spacing = a, b, last, spacing
        self._channel: ResistanceChannel | None = None

    @property
    def ambient_degC(self) -> float:
        """The room of the record that was fitted; of several the mean."""
        return self._a.parameters.usual_room_degC if self._a is not None else 0.0

    def plate(self, record: Recorded, own: RecordOwn) -> PlateRun:
        """As `sim.model.record_run.RecordRun.plate`."""
        assert self._a is not None
        return run_plate(record, self._first, self._a.parameters.plate(), own, self._spacing)

    def shown(self, record: Recorded, path: PlatePath, own: RecordOwn) -> Array:
        """-log10 of the resistance shown in each row, with the fit's coefficients."""
        assert self._b is not None
        channel = self._channel_on(record, path)
        p = self._began(self._b.parameters, own)
        shown, film_output = channel.predict_from(p, self._b, own.late)
        if links_of(p.effects).heated and record.test_current_A is not None:
            for _ in range(MOST_ROUNDS):  # from the second on the model's own resistance heats the film
                before = film_output
                p = replace(p, film_output=film_output)
                shown, film_output = channel.predict_from(p, self._b, own.late)
                if float(np.max(np.abs(film_output - before))) < SAME_DEC:
                    break
        return shown

    def _began(self, p: FilmParameters, own: RecordOwn) -> FilmParameters:
        lags = links_of(p.effects).film_lags
        x = p.x.copy()
        x[x.size - len(lags) :] = [own.late.get(e.name, 0.0) for e in lags]
        return replace(p, x=x, start=own.film, film_output=None)

    def _channel_on(self, record: Recorded, path: PlatePath) -> ResistanceChannel:
        """The last links' equations on that record; the relays' columns are kept from call to call."""
        if self._channel is None or self._channel.record is not record:
            assert self._last is not None
            assert isinstance(record, Record)
            every = np.ones(record.rows, dtype=np.bool_)
            own = self._last
            self._channel = ResistanceChannel(
                record, path, every, own.noise.elsewhere(), own.basis, own.relays, spacing=self._spacing
            )
        return self._channel if self._channel.path is path else self._channel.on(path)
