"""What a diagnosis says, beside the truth of its record."""

from __future__ import annotations

from typing import Any

from tests.truth import Effects


def names(document: dict[str, Any]) -> set[str]:
    """The effects that are named."""
    return {effect["name"] for effect in document["effects"]}


def covered(document: dict[str, Any], hidden: Effects) -> None:
    """True parameters within two half-widths of their interval, four standard deviations, and no interval that holds
    anything."""
    for effect in document["effects"]:
        for name, found in effect["parameters"].items():
            (low, high), truth = found["ci95"], hidden[effect["name"]][name]
            assert 2.0 * low - high <= truth <= 2.0 * high - low, (name, truth)
            assert high - low < 0.5 * abs(truth)
