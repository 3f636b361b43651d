"""The simulated experiments of a sweep: every value with every other, or points spread evenly over ranges."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.config.configuration import ConfigurationFile
from rig.config.effect_tables import add_effect_files, parse_effect, switch_effects
from rig.config.tables import SweepTable
from rig.core.faults import Faults, fault
from rig.rehearsal.simulated import simulated_configuration, table_in


@dataclass(frozen=True)
class Point:
    """One experiment: its number, the keys that are set, effects in words, the noise's seed."""

    number: int
    parameters: dict[str, Any]
    effects: tuple[str, ...]
    seed: int

    def identity(self) -> dict[str, Any]:
        """Its columns: numbers and text."""
        shown = {key: value if type(value) in (int, float) else str(value) for key, value in self.parameters.items()}
        return {"number": self.number, **shown, "effects": " ".join(self.effects), "seed": self.seed}


def points_of(table: SweepTable) -> Iterator[Point]:
    """The plan's points."""
    effects = [tuple(names) for names in table.effects]
    seeds = list(range(table.seeds)) if isinstance(table.seeds, int) else table.seeds
    if table.plan == "grid":
        values = itertools.product(*table.parameters.values())
        for number, (chosen, names, seed) in enumerate(itertools.product(values, effects, seeds)):
            yield Point(number, dict(zip(table.parameters, chosen, strict=True)), names, seed)
        return
    from scipy.stats import qmc

    assert table.samples is not None
    unit = qmc.LatinHypercube(len(table.ranges), seed=table.plan_seed).random(table.samples)
    lows, highs = zip(*table.ranges.values(), strict=True)
    for number, chosen in enumerate(qmc.scale(unit, lows, highs).tolist()):
        names = effects[number % len(effects)] if effects else ()
        seed = seeds[number % len(seeds)] if isinstance(table.seeds, list) and seeds else number
        yield Point(number, dict(zip(table.ranges, chosen, strict=True)), names, seed)


def configuration_at(path: Path, raw: dict[str, Any], point: Point) -> ConfigurationFile:
    """The configuration (as TOML gave it) with the point's values, effects and seed, on simulated ports. Raises
    Faults."""
    varied, effects, seed = _varied(path, raw, point)
    return simulated_configuration(path, varied, effects, seed)


def _varied(path: Path, raw: dict[str, Any], point: Point) -> tuple[dict[str, Any], list[dict[str, Any]], int]:
    """What TOML would have made of the configuration with the point's values; its effects; its seed."""
    raw = copy.deepcopy(raw)
    files = table_in(raw, "simulation").get("effect_files", [])
    add_effect_files(path.parent / name for name in (files if isinstance(files, list) else []) if isinstance(name, str))
    for key, value in point.parameters.items():
        *tables, last = key.split(".")
        inner = raw
        for name in tables:
            inner = table_in(inner, name)
        inner[last] = value
    return raw, [parse_effect(text) for text in point.effects], point.seed


def check_points(path: Path, raw: dict[str, Any], points: list[Point]) -> None:
    """Every value and every effect once, before hours are spent; of a Latin hypercube, the first and the last. Raises
    Faults."""
    if not points:
        raise fault(path, "sweep", "nothing to do: expected at least one value of each")
    hypercube = "ranges" in raw["sweep"]
    seen: set[str] = set()
    for point in (points[0], points[-1]) if hypercube else points:
        texts = [f"{key}={value}" for key, value in point.parameters.items()]
        fresh = [text for text in (*texts, str(point.effects)) if text not in seen]
        if not fresh and seen:
            continue
        seen.update(fresh)
        varied, tables, seed = _varied(path, raw, point)
        lines = switch_effects(tables, f"{path}: sweep.effects", complete=False)[1]
        if lines:
            raise Faults(lines)
        simulated_configuration(path, varied, tables, seed)
