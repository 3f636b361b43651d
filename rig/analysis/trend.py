"""Which effects a rig's runs show, how large, and since when: series of diagnoses over time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.change_point import Change, latest_change
from sim.inference.covariance import NORMAL_95


@dataclass(frozen=True, eq=False)
class Series:
    """One parameter of one effect on one rig. at: times, ISO; value, low, high: shape (runs,), nan where not named."""

    rig: str
    effect: str
    parameter: str
    at: tuple[str, ...]
    value: Array
    low: Array
    high: Array
    change: Change | None

    @property
    def seen(self) -> int:
        """In how many runs the effect was named."""
        return int(np.sum(np.isfinite(self.value)))

    @property
    def since(self) -> str:
        """When it changed, ISO; "" where it has not."""
        return self.at[self.change.since] if self.change is not None else ""

    def row(self) -> dict[str, Any]:
        """For a table."""
        row: dict[str, Any] = {"rig": self.rig, "effect": self.effect, "parameter": self.parameter}
        row |= {"named_in": self.seen, "of": len(self.at), "since": self.since}
        if self.change is not None:
            row["change"] = self.change.kind
            row |= {"before": self.change.before[0], "after": self.change.after[0]}
            row["false_alarm"] = self.change.probability
        last = np.flatnonzero(np.isfinite(self.value))
        if last.size:
            k = int(last[-1])
            row |= {"latest": float(self.value[k]), "low": float(self.low[k]), "high": float(self.high[k])}
        return {key: value for key, value in row.items() if not (isinstance(value, float) and math.isnan(value))}

    def in_words(self) -> str:
        """A line."""
        name = f"{self.effect} {self.parameter}"
        seen = f"named in {self.seen} of {len(self.at)} runs"
        c = self.change
        if c is None:
            row = self.row()
            size = f"{row['latest']:.4g} ({row['low']:.4g} to {row['high']:.4g}), " if "latest" in row else ""
            return f"{self.rig}: {name}: {size}{seen}, no change"
        if c.kind == "value":
            text = f"from {_size(c.before)} to {_size(c.after)} since {self.since[:16]}"
        elif c.kind == "appears":
            text = f"appears, {_size(c.after)}, since {self.since[:16]}"
        else:
            text = f"gone since {self.since[:16]}; it was {_size(c.before)}"
        return f"{self.rig}: {name}: {text} ({seen}; false alarm {c.probability:.1g})"


def _size(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.4g} +- {NORMAL_95 * pair[1]:.2g}"


def series_of(rows: Iterable[Mapping[str, Any]]) -> list[Series]:
    """The series of all rigs: those that changed first, the latest change at the head, then those seen most.

    rows: as `rig.analysis.one_row.of_diagnosis` makes them, with rig and at; rows without a verdict are left out.
    """
    of: dict[str, list[Mapping[str, Any]]] = {}
    for row in sorted((row for row in rows if "verdict" in row), key=lambda row: str(row["at"])):
        of.setdefault(str(row["rig"]), []).append(row)
    found = [series for rig, runs in of.items() for series in _of_rig(rig, runs)]
    found.sort(key=lambda s: s.since, reverse=True)
    return sorted(found, key=lambda s: (not s.since, 0 if s.since else -s.seen))


def _of_rig(rig: str, runs: Sequence[Mapping[str, Any]]) -> list[Series]:
    names = sorted({key.removesuffix(".low") for run in runs for key in run if key.endswith(".low")})
    at = tuple(str(run["at"]) for run in runs)
    found = []
    for name in names:
        effect, _, parameter = name.partition(".")
        value, low, high = (
            np.array([_number(run.get(key)) for run in runs]) for key in (name, f"{name}.low", f"{name}.high")
        )
        error = (high - low) / (2.0 * NORMAL_95)
        found.append(Series(rig, effect, parameter, at, value, low, high, latest_change(value, error)))
    return found


def _number(value: Any) -> float:
    return float(value) if isinstance(value, (int, float)) else math.nan
