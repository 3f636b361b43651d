"""The ohmmeter over a record: from the film's own output at the nodes to what is shown in each row.

    signal -> [leads, shunt, filters: at the nodes] -> at the times of reading -> [what comes after the last filter]

Everything but the filters is a function of the resistance alone. Effects whose log10 is linear in their last parameter
(`Reading.linear`: a range's gain) act at thresholds; which side a reading is on can be given from outside. `Ohmmeter`
is the same about one signal: for columns that add to it, each function of the resistance acts by its derivative.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Filter, Reading, Switched, at_the_terminals
from sim.model.film_nodes import FilmNodes
from sim.model.links import Links, behind, columns_followed, followed, shown_output

SLOPE_DEC = 1e-5  # of a difference quotient: rounding 1e-11, curvature 1e-10
FARTHEST_DEC = 15.0  # from 1 ohm: a trial of a fit beyond it has no resistance


def shown_in_rows(
    links: Links, nodes: FilmNodes, signal: Array, range_of: Array | None = None, late_dec: Sequence[float] = ()
) -> Array:
    """Return what is shown in every row, (rows,), for the film's own output at the points. range_of: the outputs, in
    the rows, by which the ohmmeter chooses its range; None: its own. late_dec: how far each filter is behind at the
    first node; none: at rest."""
    late = iter(late_dec)
    for e in links.ohmmeter:
        if isinstance(e.effect.form, Filter):
            log_R, _ = followed(e, nodes.points_s, -signal, np.full(1, np.nan), -next(late, 0.0))
            signal = -log_R
        else:
            signal = _read(e, signal)
    shown = signal[nodes.rows]
    for e in links.readings:
        if range_of is not None and _has_ranges(e):
            within = np.clip(range_of, -FARTHEST_DEC, FARTHEST_DEC)
            shown = shown + shown_output(e, within) - within
        else:
            shown = _read(e, shown)
    return np.asarray(shown, dtype=np.float64)


def before_ranges(links: Links, nodes: FilmNodes, signal: Array) -> Array:
    """Return the same without what acts at thresholds after the last filter: the outputs by which a range is chosen."""
    plain = [e for e in links.readings if not _has_ranges(e)]
    for e in links.ohmmeter:
        if isinstance(e.effect.form, Filter):
            signal = -followed(e, nodes.points_s, -signal, np.full(1, np.nan))[0]
        else:
            signal = _read(e, signal)
    shown = signal[nodes.rows]
    for e in plain:
        shown = _read(e, shown)
    return np.asarray(shown, dtype=np.float64)


class Ohmmeter:
    """The ohmmeter's derivative about one signal at the points.

    slope: d shown / d own output at the points, filters left out; None where it is 1 everywhere.
    """

    def __init__(self, links: Links, nodes: FilmNodes, signal: Array) -> None:
        self._nodes = nodes
        self._stages: list[Switched | Array] = []
        self.slope: Array | None = None
        for e in (*links.ohmmeter, *links.readings):
            if isinstance(e.effect.form, Filter):
                self._stages.append(e)
                if links.bends:
                    signal = followed(e, nodes.points_s, signal, np.full(1, np.nan))[0]
            elif at_the_terminals(e.effect):
                within = np.clip(signal, -FARTHEST_DEC, FARTHEST_DEC)
                up, down = shown_output(e, within + SLOPE_DEC), shown_output(e, within - SLOPE_DEC)
                slope = (up - down) / (2.0 * SLOPE_DEC)
                self.slope = slope if self.slope is None else self.slope * slope
                if self._stages and not isinstance(self._stages[-1], Switched):
                    self._stages[-1] = self._stages[-1] * slope
                else:
                    self._stages.append(slope)
                signal = 0.5 * (up + down)

    def columns(self, columns: Array) -> Array:
        """Return what columns of the film's own output, (points, k), add to what is shown, (rows, k and one for each
        filter: of its being one decade behind at the first node)."""
        return self._through(columns, True)

    def plain(self, columns: Array) -> Array:
        """Return the same without those of the filters, (rows, k)."""
        return self._through(columns, False)

    def of_rows(self, columns: Array, taken_s: Array) -> Array:
        """Return the same of columns that are known in the rows alone, (rows, k), which were taken at these times."""
        for stage in self._stages:
            if isinstance(stage, Switched):
                columns = columns_followed(stage, taken_s, columns)
            else:
                columns = columns * stage[self._nodes.rows, None]
        return columns

    @property
    def late(self) -> Array:
        """Those of the filters alone, (rows, filters)."""
        return self._through(np.empty((self._nodes.points.size, 0)), True)

    def _through(self, columns: Array, late: bool) -> Array:
        for stage in self._stages:
            if isinstance(stage, Switched):
                columns = columns_followed(stage, self._nodes.points_s, columns)
                if late:
                    columns = np.concatenate((columns, behind(stage, self._nodes.points_s)), axis=1)
            else:
                columns = columns * stage[:, None]
        return self._nodes.of_rows(columns)


def _has_ranges(e: Switched) -> bool:
    return isinstance(e.effect.form, Reading) and e.effect.form.linear


def _read(e: Switched, output: Array) -> Array:
    return shown_output(e, np.clip(output, -FARTHEST_DEC, FARTHEST_DEC))
