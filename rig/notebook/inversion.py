"""Temperatures for a wanted resistance."""

from __future__ import annotations

import warnings
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from rig.analysis.beyond_seen import beyond_seen
from rig.analysis.inverted import Inversion, inverted
from rig.core.faults import fault
from rig.core.python_words import in_python
from rig.notebook.models import as_model


@in_python()
def invert(
    model: Any,
    target: ArrayLike,
    *,
    limits_degC: tuple[float, float] = (-50.0, 200.0),
    initial: Literal["cooled", "heated"] | None = None,
) -> Inversion:
    """Temperatures that give the film these values one after the other, its memory carried along.

    model: a Model, an identification or a diagnosis, or a model file's path. target: shape (rows,), in ohm, or in the
    unit of the film's output. limits_degC: between which temperatures to look. initial: the film's memory before the
    first row, None: the model's own. A target that cannot be reached leaves the temperature as it is: `reachable` is
    False there, and `nearest` what could be had. Warns where the film was not measured at such temperatures. Raises
    Faults.
    """
    known, where = as_model(model)
    if known.film is None:
        raise fault(where, "film", "missing; expected a [film] to invert")
    if not -273.15 <= limits_degC[0] < limits_degC[1] <= 1e6:
        raise fault("invert", f"limits_degC {limits_degC}", "expected LOW < HIGH, degC")
    try:
        wanted = np.atleast_1d(np.asarray(target, dtype=np.float64))
    except (TypeError, ValueError):
        raise fault("invert", "target", "expected numbers") from None
    if wanted.ndim != 1:
        raise fault("invert", "target", f"{wanted.ndim} dimensions; expected one")
    found = inverted(known.film, wanted, "target", limits_degC, initial, known.mixing)
    note = beyond_seen(known, found.asked_degC, where)
    if note is not None:
        warnings.warn(note, stacklevel=3)
    return found
