"""What a diagnosis says, beside the truth of its case."""

from __future__ import annotations

from typing import Any

from tests.sim.diagnosis.cases import Case


def names(document: dict[str, Any]) -> set[str]:
    """The effects that are named."""
    return {effect["name"] for effect in document["effects"]}


def covered(document: dict[str, Any], blind: Case, widths: float = 2.0) -> None:
    """True parameters within two half-widths of their interval: four standard deviations."""
    for effect in document["effects"]:
        for name, found in effect["parameters"].items():
            if found["ci95"] is None:
                continue
            low, high = found["ci95"]
            truth = blind.hidden[effect["name"]][name]
            assert low - (widths - 1.0) * (high - low) <= truth <= high + (widths - 1.0) * (high - low), (name, truth)
