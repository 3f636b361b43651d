"""What a film's record cannot fix, in plain words, and which profile would fix it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compensator.film import FilmModel
from compensator.functions import Array
from compensator.identify_rows import Prepared
from compensator.temperature_path import turning_points


def film_notes(records: Sequence[Prepared], model: FilmModel, columns: Array, residual: Array) -> tuple[str, ...]:
    """Sentences, one for each thing that these records leave open; empty if they fix the model."""
    return ()
