"""A diagnosis, or an identification, as one row of a table: numbers and text by column."""

from __future__ import annotations

from typing import Any

import numpy as np

CHANNELS = {"temperature_K": "K", "resistance_dec": "dec"}


def of_diagnosis(document: dict[str, Any]) -> dict[str, Any]:
    """verdict; effects and their sizes in the words of `simulate --effect`; what is left; then of each parameter
    NAME.PARAMETER with .low and .high of its 95 % interval, and NAME.evidence. document: peltier-diagnosis/1."""
    effects = document["effects"]
    row: dict[str, Any] = {"verdict": document["verdict"], "named": " ".join(sizes(effect) for effect in effects)}
    row["left"] = " / ".join(f"{key}: {text}" for key, text in document["unexplained"].items() if text)
    for key, unit in CHANNELS.items():
        channel = document["channels"].get(key)
        if channel is not None:
            row |= {f"noise_{unit}": channel["noise"], f"rmse_base_{unit}": channel["rmse_base"]}
            row[f"rmse_extended_{unit}"] = channel["rmse_extended"]
    for effect in effects:
        name = effect["name"]
        row[f"{name}.evidence"] = effect["evidence"]
        for parameter, found in effect["parameters"].items():
            row[f"{name}.{parameter}"] = found["value"]
            if found["ci95"] is not None:
                row[f"{name}.{parameter}.low"], row[f"{name}.{parameter}.high"] = found["ci95"]
    return row


def sizes(effect: dict[str, Any]) -> str:
    """film_lag:tau_s=2.27"""
    values = ",".join(f"{name}={found['value']:.4g}" for name, found in effect["parameters"].items())
    return f"{effect['name']}:{values}"


def of_fits(film: Any, plate: Any, unit: str) -> dict[str, Any]:
    """film: a `FilmFit` or None; plate: a `PlateFit` or None; unit: of the film's output."""
    row: dict[str, Any] = {}
    if film is not None:
        row |= {
            "film": film.model.kind,
            "memoryless": film.model.memoryless.function,
            "operators": film.active_operators,
        }
        row |= {f"film_rmse_{unit}": film.rmse, f"film_held_out_rmse_{unit}": film.held_out_rmse}
    if plate is not None:
        row |= {"plate": plate.model.kind, "plate_rmse_K": plate.rmse_K, "plate_noise_K": plate.noise_K}
        for name, value, error in zip(plate.names, plate.values, plate.standard_errors, strict=True):
            row |= {
                name: float(value),
                f"{name}.low": float(value - 1.96 * error),
                f"{name}.high": float(value + 1.96 * error),
            }
    return {name: value for name, value in row.items() if not is_missing(value)}


def is_missing(value: Any) -> bool:
    """Whether a number is none."""
    return isinstance(value, (float, np.floating)) and not np.isfinite(value)
