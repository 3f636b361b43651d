"""Where the search for a film begins: envelopes from a global search on thinned rows, and the memory it began with."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask
from sim.diagnosis.fit.film_basis import ENVELOPES
from sim.inference.film.memoryless_forms import SMOOTH, Form
from sim.inference.film.multistart import search
from sim.inference.film.rows import Path
from sim.inference.film.variable_projection import equal_structure
from sim.model.film_nodes import FilmNodes
from sim.model.record_own import FilmStart

ROWS = 700  # enough for envelopes to begin with
OPERATORS = 20  # the same of weights
STARTS = 96  # over four parameters: about three values of each


def thinned_path(nodes: FilmNodes, output: Array, used: Mask, start: FilmStart) -> Path:
    """The turning points and some of the readings."""
    v = nodes.film_degC
    rows = np.flatnonzero(used)
    rows = rows[np.unique(np.linspace(0, rows.size - 1, min(ROWS, rows.size)).round().astype(np.int64))]
    at = nodes.taken[rows]
    step = np.sign(np.diff(v))
    turn = np.flatnonzero(step[1:] * step[:-1] < 0.0) + 1
    index = np.unique(np.concatenate(([0], turn, at)))
    inputs = v[index]
    position = np.searchsorted(index, at)
    order = np.argsort(position, kind="stable")
    if start.previous_degC is not None:
        inputs, position = np.concatenate(([start.previous_degC], inputs)), position + 1
    side = np.empty(inputs.size, dtype=np.int8)
    side[0] = -2 if start.initial == "cooled" else 2
    side[1:] = np.sign(np.diff(inputs))
    return Path(
        inputs,
        side,
        position[order].astype(np.int64),
        output[rows][order],
        np.zeros(rows.size, dtype=np.int64),
        rows[order],
    )


def starting_shape(path: Path, curve: bool) -> tuple[Array, float]:
    """(log a_R, c_R, log a_L, c_L) of the best film found, and its mean square."""
    low, high = float(np.min(path.inputs)), float(np.max(path.inputs))
    form = Form(SMOOTH if curve else "none", False, low, high)
    found = search(path, equal_structure(OPERATORS), [form], starts=STARTS)[form]
    return found.theta[:ENVELOPES].copy(), found.square
