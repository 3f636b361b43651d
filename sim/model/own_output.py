"""What the ohmmeter shows for the film's own output, leads, shunt and ranges alone, as a table to be read backwards."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Reading, Switched
from sim.model.film_side import Film
from sim.model.links import Links, shown_output

COLDEST_DEGC, HOTTEST_DEGC = -50.0, 200.0  # between which films are used
SWEEP, PLACES = 2001, 8001  # temperatures; outputs of the table, 1e-3 dec apart over 8 decades
BEYOND_DEC = 1.0  # of what the film reaches, or what was shown: a disturbed estimate may lie outside


def own_output_table(links: Links, film: Film | None) -> tuple[Array, Array] | None:
    """Return (what the ohmmeter shows, the film's own output), both -log10 R, increasing, shape (places,); None where
    they are the same, or there is no film."""
    readings = _readings(links)
    if film is None or not readings:
        return None
    up = np.linspace(COLDEST_DEGC, HOTTEST_DEGC, SWEEP)
    reach = np.concatenate([film.simulate(v, film.initial_memory(float(v[0])))[0] for v in (up, up[::-1])])
    return _table(readings, float(reach.min()), float(reach.max()))


def own_output(links: Links, shown: Array) -> Array:
    """Return the film's own output for what an ohmmeter without a lag showed, both -log10 R, shape (readings,)."""
    readings = _readings(links)
    if not readings or not shown.size:
        return shown
    return np.asarray(np.interp(shown, *_table(readings, float(shown.min()), float(shown.max()))), dtype=np.float64)


def _readings(links: Links) -> list[Switched]:
    return [e for e in (*links.ohmmeter, *links.readings) if isinstance(e.effect.form, Reading)]


def _table(readings: list[Switched], low: float, high: float) -> tuple[Array, Array]:
    own = np.linspace(low - BEYOND_DEC, high + BEYOND_DEC, PLACES)
    shown = own
    for e in readings:
        shown = shown_output(e, shown)
    return np.maximum.accumulate(shown), own
