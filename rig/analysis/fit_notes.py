"""What is to be said of a fit beside its numbers: the same of a record that is identified and of a calibration."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from compensator.inverse.check import Finding
    from sim.inference.plate.fit import PlateFit

MISFIT: Final = 2.0  # times the noise: beyond it a model does not describe its record


def plate_notes(fit: PlateFit, told: Iterable[str] = ()) -> list[str]:
    """What the record does not fix of its plate, and first whether the model describes the record at all. told: of the
    film of the same record, not to be told again."""
    before = set(told)
    notes = [note for note in fit.identifiability if note not in before]
    if fit.rmse_K > MISFIT * fit.noise_K and not fit.far_off:  # of which the first note tells
        times = fit.rmse_K / max(fit.noise_K, 1e-9)  # no thermometer resolves a nanokelvin
        notes.insert(
            0,
            f"The model leaves {times:.0f} times the thermometer's noise: something is missing, "
            "such as a heat sink that warms up or a thermometer that lags, and the intervals above are too narrow.",
        )
    return notes


def finding_notes(findings: Iterable[Finding]) -> list[str]:
    """What to know of a film model before it is used, between the temperatures seen."""
    return [
        f"{finding.what}: {finding.advice}"
        for finding in findings
        if not finding.kind.startswith("iteration")  # the paper's method, which nothing here relies on
    ]


def finding_documents(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """All of them as plain values."""
    return [
        {
            "kind": finding.kind,
            "what": finding.what,
            "where_degC": list(finding.where_degC) if finding.where_degC else None,
            "operators": list(finding.operators),
            "advice": finding.advice,
        }
        for finding in findings
    ]
