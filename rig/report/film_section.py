"""The part of a report on a film's transition: the table, the derivative, the FORC diagram."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rig.analysis.transition_words import forc_note, rows
from rig.report.film_figures import derivative_figure, forc_figure
from rig.report.page import bullets, paragraph, section, table

if TYPE_CHECKING:
    from rig.analysis.film_numbers import FilmNumbers


def transition_section(folder: Path, numbers: FilmNumbers, suffix: str = "", title: str = "The transition") -> str:
    """Of one record; suffix: of the figures' names, where a page shows several records."""
    found, forc = numbers.transition, numbers.forc
    parts = [
        table(
            ["what", "value and 95 % interval"],
            [[a, b.replace("+-", "\N{PLUS-MINUS SIGN}")] for a, b in rows(found, numbers.unit)],
        ),
        bullets(numbers.notes()),
    ]
    if found.shapes:
        parts.append(derivative_figure(folder, found, f"derivative{suffix}", numbers.unit))
    if forc.reason or not np.any(np.isfinite(forc.density)):
        parts.append(paragraph(forc_note(forc), "note"))
    else:
        parts.append(forc_figure(folder, forc, f"forc{suffix}"))
    return section(title, *parts)
