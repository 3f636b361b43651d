"""What was found and is not named, as models that can be run: the one that tells held-out rows best comes first.

A candidate is judged by the diagnosis' own fit; what is handed over is a model of the class, its film told by further
records, too. That may tell less than the fit did: so it is the model that decides which candidate is tried, and whether
any is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from rig.analysis.diagnosed import rows_of_film
from rig.records.record_file import Record
from sim.diagnosis.extended_model import ExtendedModel, extended_model
from sim.diagnosis.report.candidates import Candidate
from sim.diagnosis.result import Diagnosis


def best_tried(
    diagnosis: Diagnosis, named: ExtendedModel, of_film: Sequence[Record] = ()
) -> tuple[Diagnosis, ExtendedModel | None]:
    """The diagnosis with its candidates in the order of what their models tell, and the first one's model; None where
    no model tells held-out rows better than the one with what is named. of_film: other records of the film."""
    if not diagnosis.candidates:
        return diagnosis, None
    rows = rows_of_film(diagnosis, of_film)
    models = [(candidate, extended_model(diagnosis, candidate, rows)) for candidate in diagnosis.candidates]
    ranked = sorted(models, key=lambda pair: _told_less(pair[0], pair[1], named))
    better = [model for candidate, model in ranked if _told_less(candidate, model, named) < 0.0]
    ordered = replace(diagnosis, candidates=[candidate for candidate, _ in ranked])
    return ordered, better[0] if better else None


def _told_less(candidate: Candidate, model: ExtendedModel, named: ExtendedModel) -> float:
    """log of the error in held-out rows over that of what is named, summed over the channels: by so much per row is the
    likelihood of normal errors lower. The film's channel as the models tell it, the other as the diagnosis does."""
    errors = {c: (candidate.rmse_holdout[c], candidate.rmse_named[c]) for c in candidate.rmse_named}
    if model.rmse is not None and named.rmse is not None:
        errors = {c: pair for c, pair in errors.items() if c == "temperature_K"}
        errors["film"] = (model.rmse, named.rmse)
    # > 0: of a simulated record an error may be 0
    return sum(math.log(max(after, 1e-300) / max(before, 1e-300)) for after, before in errors.values())
