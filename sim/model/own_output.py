"""What the ohmmeter shows for the film's own output, leads, shunt and ranges alone, as a table to be read backwards."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Reading
from sim.model.film_side import Film
from sim.model.links import Links, shown_output

COLDEST_DEGC, HOTTEST_DEGC = -50.0, 200.0  # between which films are used
SWEEP, PLACES = 2001, 8001  # temperatures; outputs of the table, 1e-3 dec apart over 8 decades
BEYOND_DEC = 1.0  # of what the film reaches: a disturbed estimate may lie outside


def own_output_table(links: Links, film: Film | None) -> tuple[Array, Array] | None:
    """(what the ohmmeter shows, the film's own output), both -log10 R, increasing, shape (places,); None where they are
    the same, or there is no film."""
    readings = [e for e in (*links.ohmmeter, *links.readings) if isinstance(e.effect.form, Reading)]
    if film is None or not readings:
        return None
    up = np.linspace(COLDEST_DEGC, HOTTEST_DEGC, SWEEP)
    reach = np.concatenate([film.simulate(v, film.initial_memory(float(v[0])))[0] for v in (up, up[::-1])])
    own = np.linspace(float(reach.min()) - BEYOND_DEC, float(reach.max()) + BEYOND_DEC, PLACES)
    shown = own
    for e in readings:
        shown = shown_output(e, shown)
    return np.maximum.accumulate(shown), own
