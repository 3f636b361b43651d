"""[sweep]: what `peltier sweep` varies, and what it makes of each case."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from rig.files.bounded_numbers import LARGEST
from rig.files.toml_file import Table

What = Literal["experiment", "identification", "diagnosis"]
MOST = 1_000_000  # of cases: beyond it a table is none


class SweepTable(Table):
    """[sweep].

    what: of each case the experiment alone, or what identification or diagnosis make of its record. records: files to
    identify or to diagnose, in the place of simulated experiments; names with * and ? beside this file.
    plan: "grid", every value with every other, or "latin_hypercube", `samples` points in `ranges`.
    seeds: of the noise, a list or how many; a Latin hypercube takes one for each point. effects: alternatives, each a
    list of effects as `simulate --effect` names them. parameters: lists of values for keys of this file, as in
    "control.ms" = [1.2, 1.4]. ranges: of a Latin hypercube, [low, high] of a key. plan_seed: of its points.
    """

    what: What = "experiment"
    records: list[str] = []
    plan: Literal["grid", "latin_hypercube"] = "grid"
    seeds: Annotated[int, Field(ge=0, le=MOST)] | list[int] = Field(default=1)
    effects: list[list[str]] = [[]]
    parameters: dict[str, list[Any]] = {}
    ranges: dict[str, tuple[Annotated[float, Field(ge=-LARGEST, le=LARGEST)], Annotated[float, Field(le=LARGEST)]]] = {}
    samples: Annotated[int, Field(ge=1, le=MOST)] | None = None
    plan_seed: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _one_plan(self) -> SweepTable:
        if self.records and self.what == "experiment":
            raise ValueError('records: expected what = "identification" or "diagnosis" beside them')
        if self.records and (self.parameters or self.ranges or self.effects != [[]]):
            raise ValueError("records: expected no parameters, ranges or effects beside them; a record is as it is")
        if self.plan == "grid" and (self.ranges or self.samples is not None):
            raise ValueError('ranges, samples: expected plan = "latin_hypercube" beside them')
        if self.plan == "latin_hypercube" and (not self.ranges or self.samples is None or self.parameters):
            raise ValueError('plan "latin_hypercube": expected ranges and samples, and no parameters')
        for key, (low, high) in self.ranges.items():
            if not low < high:
                raise ValueError(f"ranges: {key}: expected [low, high] with low < high")
        return self


class SweepFile(Table):
    """The part of a configuration that says it, so that a fault is told with the table's name."""

    sweep: SweepTable
