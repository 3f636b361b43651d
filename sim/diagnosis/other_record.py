"""A fit on another record of the same rig: the model held, what belongs to that record fitted (`sim.model.own_fit`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.chain import Chain
from sim.diagnosis.path_estimate import measured_path
from sim.diagnosis.record import Mask, Record
from sim.diagnosis.residuals import read_within
from sim.diagnosis.resistance_channel import ResistanceChannel
from sim.diagnosis.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.temperature_channel import TemperatureFit
from sim.model.links import Links, links_of
from sim.model.own_fit import LEAST_NOISE_DEC, LEAST_NOISE_K, Told, fit_own
from sim.model.plate_path import PlatePath, PlateRun
from sim.model.record_own import FilmStart, RecordOwn
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
        """The room of the record that was fitted."""
        return float(self._a.parameters.plate()[4]) if self._a is not None else 0.0

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
                record, path, every, own.sigma_dec, own.basis, own.relays, spacing=self._spacing
            )
        return self._channel if self._channel.path is path else self._channel.on(path)


def residuals_on(chain: Chain, names: frozenset[str], other: Record, rows: Mask | None = None) -> dict[str, Array]:
    """Residuals of the fit with these effects in the other record's rows, in K and decades; nan without a reading.

    rows: those by which what belongs to the record is fitted, nan in the residuals; None: all of them, none left out.
    """
    a, b = chain.fits(names)
    driven = a is not None and other.current_A is not None
    read = b is not None and other.output is not None
    last = chain.film_channel(names) if read else None
    fitted = FittedChain(a, b, last)
    told = told_of(other, a.sigma_K if a is not None else LEAST_NOISE_K, last.sigma_dec if last else LEAST_NOISE_DEC)
    if not read:
        told = replace(told, output=None)
    path = None if driven else measured_path(other)
    memory = FilmStart(b.parameters.start.initial) if b is not None else FilmStart()
    own, path = fit_own(fitted, other, told if rows is None else told.only(rows), memory, path)
    unseen = np.ones(other.rows, dtype=np.bool_) if rows is None else ~rows
    out: dict[str, Array] = {}
    if driven:
        left = told.temperature_degC - fitted.plate(other, own).shown_degC
        out["temperature_K"] = np.where(unseen, left, np.nan)
    if read and b is not None and told.output is not None:
        known = unseen & read_within(other, links_of(b.effects).taken(other.taken_s))
        out["resistance_dec"] = np.where(known, told.output - fitted.shown(other, path, own), np.nan)
    return out


def told_of(record: Record, sigma_K: float, sigma_dec: float) -> Told:
    """The readings of a record that count."""
    output = np.where(record.output_used, record.output, np.nan) if record.output is not None else None
    temperature = np.where(record.temperature_used, record.temperature_degC, np.nan)
    return Told(temperature, output, max(sigma_K, 0.3 * record.step_K), sigma_dec)
