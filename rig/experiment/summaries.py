"""What came out of an experiment, as plain values: for run.json, for --json, for the report."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

from compensator.control.design import Design
from rig.analysis.fit_notes import finding_documents, finding_notes, plate_notes
from rig.experiment.calibration import Calibration

if TYPE_CHECKING:
    from rig.experiment.session import Result
    from sim.inference.plate.fit import PlateFit

# What comes after it frightens whoever only wants to track, and mostly need not: the demo's heat sink puts its plate's
# model off by 49 times the noise, and its law with feedback holds the film all the same.
FAR_OFF_IN_A_RUN: Final = (
    "A law with feedback makes up for most of a model that is off for a slow cause, such as a heat sink; not for a "
    "thermometer that lags, and feedforward alone for neither. `peltier diagnose` on the record looks for the cause."
)


def design_table(design: Design) -> dict[str, Any]:
    """A design as plain values, for run.json and the report."""
    return {
        "gains": design.gains._asdict(),
        "margins": dict(design.margins.__dict__),
        "closed_loop_time_s": design.closed_loop_time_s,
        "process_gain": design.process_gain,
        "process_pole_per_s": design.process_pole_per_s,
        "dead_time_s": design.dead_time_s,
        "period_s": design.period_s,
    }


def calibration_result(result: Calibration) -> dict[str, Any]:
    """What came out as run.json keeps it: all that the report says."""
    film, plate = result.film, result.plate
    parameters = zip(plate.names, plate.values, plate.standard_errors, strict=True)
    return {
        "check_rmse_dec": result.check_rmse_dec,
        "check_max_dec": result.check_max_dec,
        "check_rmse_K": result.check_rmse_K,
        "rmse_dec": film.rmse,
        "rows_checked": result.rows_checked,
        "transition_degC": list(result.transition_degC),
        "memoryless": film.model.memoryless.function,
        "operators": int((film.model.weights > 0.0).sum()),
        "plate": [{"name": name, "value": value, "standard_error": error} for name, value, error in parameters],
        "identifiability": [*result.left_out, *film.identifiability, *of_the_plate(plate, film.identifiability)],
        "lag_s": plate.lag_s,
    }


def calibration_notes(result: Calibration) -> list[str]:
    """What `peltier identify` says of the same rows, beside the transition's numbers: a line each."""
    film = [*result.film.identifiability, *finding_notes(result.findings)]
    return [
        *result.left_out,
        *(f"film: {note}" for note in film),
        *(f"plate: {note}" for note in of_the_plate(result.plate, film)),
    ]


def of_the_plate(fit: PlateFit, told: Iterable[str]) -> list[str]:
    """`plate_notes`, and before a model that is far off what that means for a run with it."""
    notes = plate_notes(fit, told)
    return [FAR_OFF_IN_A_RUN, *notes] if fit.far_off else notes


def calibration_summary(result: Calibration) -> dict[str, Any]:
    """What came out, as `peltier calibrate --json` tells it."""
    return {
        "format": "peltier-calibration/1",
        "folder": result.model_path.parent,
        "model": result.model_path,
        "check_rmse_dec": result.check_rmse_dec,
        "check_max_dec": result.check_max_dec,
        "check_rmse_K": result.check_rmse_K,
        "rows_fitted": result.rows_fitted,
        "rows_checked": result.rows_checked,
        "transition_degC": list(result.transition_degC),
        "identifiability": [
            *result.left_out,
            *result.film.identifiability,
            *of_the_plate(result.plate, result.film.identifiability),
        ],
        "check": finding_documents(result.findings),
        "transition": [result.numbers.document()] if result.numbers is not None else [],
    }


def summary(result: Result) -> dict[str, Any]:
    """What came out, as `peltier run --json` tells it."""
    calibration = result.calibration
    return {
        "format": "peltier-run-result/1",
        "folder": result.folder,
        "scores": {score.law: score.table() for score in result.scores},
        "repeated": [score.table() for score in result.repeated],
        "designs": {name: design_table(design) for name, design in result.designs.items()},
        "calibration": None
        if calibration is None
        else {
            "model": calibration.model_path,
            "check_rmse_dec": calibration.check_rmse_dec,
            "rows_fitted": calibration.rows_fitted,
            "rows_checked": calibration.rows_checked,
        },
    }
