"""Blind cases from seeds: a record, what is hidden in it, and what a diagnosis has to say about it.

    case("one", 3)                              one hidden effect, drawn from the seed
    case("one", 3, effect="film_lag")           this one
    case("two", 3), case("two", 3, effects=("creep", "sensor_lag")), case("three", 3), case("clean", 3)

A case depends on its kind, seed and choice alone. Currents were recorded from a closed loop that the diagnosis does not
see.
"""

from __future__ import annotations

import csv
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.draw import Bench
from tests.sim.diagnosis.truth.rig import Effects

Array = NDArray[np.float64]
Columns = dict[str, Array]
KINDS = (
    "one",
    "two",
    "three",
    "clean",
    "other_film",
    "other_film_effect",
    "further_film",
    "domains",
    "outside",
    "indistinguishable",
    "disturbed",
    "smallest",
    "negative",
    "unlike",
    "real_noise",
    "coloured_noise",
)


@dataclass(frozen=True)
class Case:
    """A record as in `Records`, and the truth about it.

    expectation: "exactly" (the hidden effects and no other), "clean", "unexplained" (something is left, and no name),
    "set" (one of `acceptable`, the others named as indistinguishable), "no_name". options: what `diagnose` is called
    with besides. holdout: a record of the same rig on a profile of another kind. follow_up: the record of the
    experiment that decides, with the hidden effect alone as its answer. details: what a table may want to know.
    """

    kind: str
    seed: int
    columns: Columns
    hidden: Effects
    expectation: str
    film: str
    noise: dict[str, float]
    acceptable: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    holdout: Columns | None = None
    follow_up: Columns | None = None
    details: dict[str, Any] = field(default_factory=dict)
    bench: Bench | None = field(default=None, repr=False, compare=False)


def case(kind: str, seed: int, **choice: Any) -> Case:
    """The case of this kind and seed; see `tests.sim.diagnosis.truth.plans` for what can be chosen."""
    from tests.sim.diagnosis.truth import plans

    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}: expected one of {', '.join(KINDS)}")
    chosen = ",".join(f"{key}={choice[key]}" for key in sorted(choice))
    rng = np.random.default_rng([zlib.crc32(f"{kind}:{chosen}".encode()), seed])
    return plans.PLANS[kind](rng, seed, **choice)


def write_record(case: Case, path: Path | str, columns: Columns | None = None) -> None:
    """The record as CSV; numbers read back to the same bits, a missing reading is an empty field."""
    columns = case.columns if columns is None else columns
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(["" if np.isnan(value) else repr(float(value)) for value in row])
