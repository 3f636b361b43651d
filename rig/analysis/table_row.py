"""A diagnosis, or an identification, as one row of a table: numbers and text by column."""

from __future__ import annotations

from typing import Any

import numpy as np

CHANNELS = {"temperature_K": "K", "resistance_dec": "dec"}


def of_diagnosis(document: dict[str, Any]) -> dict[str, Any]:
    """Return verdict; effects and their sizes as `simulate --effect` takes them; what is left; then of each parameter
    NAME.PARAMETER with .low and .high of its 95 % interval, and NAME.evidence. document: peltier-diagnosis/1."""
    effects = document["effects"]
    row: dict[str, Any] = {"verdict": document["verdict"], "named": " ".join(sizes(effect) for effect in effects)}
    left = document.get("left", document["unexplained"])  # one of an earlier version has no more
    row["left"] = " / ".join(f"{key}: {text}" for key, text in left.items() if text)
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
    """Return an effect as `simulate --effect` takes it: film_lag:tau_s=2.27."""
    values = ",".join(f"{name}={found['value']:.4g}" for name, found in effect["parameters"].items())
    return f"{effect['name']}:{values}"


def of_identification(document: dict[str, Any]) -> dict[str, Any]:
    """Return kinds and errors of film and plate, their parameters and the transition's numbers, each with .low and
    .high of its 95 % interval. document: peltier-identification/1, of one record."""
    row: dict[str, Any] = {}
    film, plate = document.get("film"), document.get("plate")
    if film is not None:
        row |= {"film": f"{film['kind']}, D(T) {film['memoryless']}", "operators": film["active_operators"]}
        row |= {f"film_{name.partition('rmse')[0]}rmse": value for name, value in film.items() if "rmse_" in name}
    quantities = dict(document["transition"][0]) if document.get("transition") else {}
    if plate is not None:
        row |= {"plate": plate["kind"], "plate_rmse_K": plate["rmse_K"], "plate_noise_K": plate["noise_K"]}
        quantities |= plate["parameters"]
    for name, found in quantities.items():
        if isinstance(found, dict) and found.get("value") is not None:
            row[name] = found["value"]
            if found.get("ci95"):
                row[f"{name}.low"], row[f"{name}.high"] = found["ci95"]
    return {name: value for name, value in row.items() if not is_missing(value)}


def is_missing(value: Any) -> bool:
    """Return True for a number that is not finite."""
    return isinstance(value, (float, np.floating)) and not np.isfinite(value)
