"""Results as rows of a table, and series of diagnoses over time: which effects a rig shows, how large, since when.

A run has a value with its standard error, or no value (the effect was not seen). Two tests, each over every possible
run k of the change and, before and after it, at least `FEWEST` runs:

value    z = (mean after - mean before) / sqrt(s^2 (1/W_after + 1/W_before)),  means weighted by W = sum of 1/error^2,
         s^2 the scatter about the means in units of the errors, at least 1: runs scatter more than one run's errors
         say. Compared with Student's t with the runs' degrees of freedom.
seen     Fisher's exact test of how often the effect was seen before and after: it appears, or it is gone.

A change is reported if the test's probability, corrected for how often it was tried, is below `false_alarm`: at most
so often a series without a change has one. It is looked for at every run anew, and at every run until then: n runs have
n^2 / 2 tests of the value. (Tests of what was seen are fewer, because only so many tables can come out, and exact,
which a discrete test is only from above: they are corrected by n.) Of several changes the latest counts: what holds
from then on until now is judged by itself, so that a second change is found, and an old one is not reported again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import fisher_exact, t

from compensator.hysteresis.functions import Array
from sim.inference.covariance import NORMAL_95

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
    return {k: v for k, v in row.items() if not isinstance(v, (float, np.floating)) or np.isfinite(v)}


FEWEST = 2  # runs on either side: of one alone nobody knows whether the run or the rig was another
FALSE_ALARM = 0.05  # of a series


@dataclass(frozen=True)
class Change:
    """A change of a series. since: the first run (index) of the new state. before, after: (mean, standard error), nan
    where not seen; kind: "value", "appears" or "gone"; probability: of such a difference by chance, corrected for the
    search."""

    since: int
    kind: str
    before: tuple[float, float]
    after: tuple[float, float]
    probability: float


def latest_change(value: Array, error: Array, false_alarm: float = FALSE_ALARM) -> Change | None:
    """Return the latest change of a series; None if there is none.

    value: shape (runs,), nan where the effect was not seen; error: standard errors, > 0, nan where unknown.
    """
    begin, found = 0, None
    while True:
        change = _strongest(value[begin:], error[begin:], false_alarm)
        if change is None:
            return found
        found = Change(begin + change.since, change.kind, change.before, change.after, change.probability)
        begin += change.since


def _strongest(value: Array, error: Array, false_alarm: float) -> Change | None:
    trials = [*_by_value(value, error), *_by_presence(value)]
    if not trials:
        return None
    corrected, since, kind = min(trials)
    if corrected > false_alarm:
        return None
    return Change(
        since, kind, _mean(value[:since], error[:since])[:2], _mean(value[since:], error[since:])[:2], corrected
    )


def _by_value(value: Array, error: Array) -> list[tuple[float, int, str]]:
    """Return (corrected probability, run, "value") for every run at which the value may have changed."""
    seen = np.flatnonzero(np.isfinite(value) & np.isfinite(error))
    found = []
    for k in range(FEWEST, seen.size - FEWEST + 1):
        sides = seen[:k], seen[k:]
        (a, a_error, a_square), (b, b_error, b_square) = (_mean(value[side], error[side]) for side in sides)
        freedom = seen.size - 2
        scatter = max(1.0, (a_square + b_square) / freedom) if freedom > 0 else 1.0
        z = abs(b - a) / math.sqrt(scatter * (a_error**2 + b_error**2))
        tests = max(1.0, 0.5 * seen.size**2)
        found.append((min(1.0, tests * 2.0 * float(t.sf(z, max(freedom, 1)))), int(seen[k]), "value"))
    return found


def _by_presence(value: Array) -> list[tuple[float, int, str]]:
    """Return (corrected probability, run, "appears" or "gone") for every run from which it was seen more, or less."""
    seen = np.isfinite(value)
    if np.all(seen) or not np.any(seen):
        return []
    found = []
    for k in range(FEWEST, seen.size - FEWEST + 1):
        before, after = int(np.sum(seen[:k])), int(np.sum(seen[k:]))
        table = [[before, k - before], [after, seen.size - k - after]]
        kind = "appears" if after / (seen.size - k) > before / k else "gone"
        found.append((min(1.0, seen.size * float(fisher_exact(np.array(table))[1])), k, kind))
    return found


def _mean(value: Array, error: Array) -> tuple[float, float, float]:
    """Return weighted mean, its standard error, and sum of squares about it in units of the errors."""
    good = np.isfinite(value) & np.isfinite(error)
    if not np.any(good):
        return math.nan, math.nan, 0.0
    weight = 1.0 / error[good] ** 2
    mean = float(np.sum(weight * value[good]) / np.sum(weight))
    return mean, 1.0 / math.sqrt(float(np.sum(weight))), float(np.sum(weight * (value[good] - mean) ** 2))


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
        return int(np.sum(np.isfinite(self.value)))

    @property
    def since(self) -> str:
        """Time of the change, ISO; "" if there is none."""
        return self.at[self.change.since] if self.change is not None else ""

    def row(self) -> dict[str, Any]:
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
    """Return the series of all rigs: those that changed first, the latest change at the head, then those seen most.

    rows: as `rig.analysis.trend.of_diagnosis` makes them, with rig and at; rows without a verdict are left out.
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
        read = [[run.get(key) for run in runs] for key in (name, f"{name}.low", f"{name}.high")]
        value, low, high = np.array([[v if isinstance(v, (int, float)) else math.nan for v in row] for row in read])
        error = (high - low) / (2.0 * NORMAL_95)
        found.append(Series(rig, effect, parameter, at, value, low, high, latest_change(value, error)))
    return found
