"""The experiment of a configuration on the simulated rig, whatever its ports, and its record."""

from __future__ import annotations

import math
import tempfile
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.bench.assembly import simulated_world
from rig.config.configuration import ConfigurationFile, configuration_of
from rig.config.effect_tables import add_effect_files, parse_effect, switch_effects
from rig.config.toml_file import read_text, read_toml
from rig.control.decision import Onlooker
from rig.core.faults import Faults, fault
from rig.core.outcome import Tripped
from rig.experiment.feasibility import target_of
from rig.experiment.session import run
from rig.records.record_file import read_record
from rig.records.run_folder import part_of
from sim.effects.effect import Switched
from sim.world.plant import simulate_record, stamp_s

TEST_CURRENT_A = 1e-4  # what ohmmeters send through 10 kohm


@dataclass(frozen=True, eq=False)
class Simulated:
    """Columns of the record, and the effects that were switched on. ended: the trip that ended the experiment, if one
    did."""

    columns: dict[str, Array | list[str]]
    effects: tuple[Switched, ...]
    ended: Tripped | None = None

    @property
    def rows(self) -> int:
        return len(self.columns["time_s"])

    def column(self, name: str) -> Any:
        """Return a column, nan in every row if the record does not have it."""
        found = self.columns.get(name)
        return np.array(found) if found is not None else np.full(self.rows, np.nan)


def simulated_rig() -> dict[str, Any]:
    """Return the tables of a simulated rig, to be changed and given to `simulate` or `open_bench`.

    tables = rig.simulated_rig()
    tables["simulation"]["seed"] = 7
    """
    return tomllib.loads(resources.files("rig.templates").joinpath("simulated.toml").read_text(encoding="utf-8"))


def read_simulation(path: Path, effects: list[str], effect_files: list[Path], seed: int | None) -> ConfigurationFile:
    """Read a configuration, with simulated ports on virtual time and further effects in words. Raises Faults."""
    return simulated_configuration(path, read_toml(path), read_effects(effects, effect_files), seed)


def read_effects(effects: Iterable[str], effect_files: Iterable[Path]) -> list[dict[str, Any]]:
    """Return effects in words as their tables; effect_files: with user-defined effects, loaded first. Raises Faults."""
    add_effect_files(effect_files)
    tables, lines = [], []
    for text in effects:
        try:
            table = parse_effect(text)
        except Faults as faults:
            lines += faults.lines
            continue
        tables.append(table)
        lines += [line.replace("[0]", "", 1) for line in switch_effects([table], "--effect", complete=False)[1]]
    if lines:
        raise Faults(lines)
    return tables


def simulated_configuration(
    path: Path, raw: dict[str, Any], effects: list[dict[str, Any]], seed: int | None, text: str | None = None
) -> ConfigurationFile:
    """Return the configuration of a file at `path`, raw as TOML gave it, on simulated ports. text: the file's, None: it
    is read. Raises Faults."""
    bench = table_in(raw, "bench")
    bench.pop("time", None)
    for role in ("controller", "meter"):
        if role in bench:
            table_in(bench, role)["port"] = "sim://"
    table_in(raw, "experiment")["compare"] = []
    simulation = table_in(raw, "simulation")
    there = simulation.get("effects", [])
    if effects and isinstance(there, list):
        simulation["effects"] = [*there, *effects]
    if seed is not None:
        if seed < 0:
            raise fault("--seed", repr(seed), "expected a number >= 0")
        simulation["seed"] = seed
    return configuration_of(path, read_text(path) if text is None else text, raw)


def table_in(table: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a table inside another; what is no table is left for the schema to refuse."""
    inner = table.setdefault(name, {})
    return inner if isinstance(inner, dict) else {}


def simulate(file: ConfigurationFile, say: Callable[[str], None], onlooker: Onlooker | None) -> Simulated:
    """Simulate the experiment. Raises Faults, RigError, Outcome."""
    if file.content.experiment.kind == "current_profile":
        return _open_loop(file)
    return _closed_loop(file, say, onlooker)


def _open_loop(file: ConfigurationFile) -> Simulated:
    """Simulate a current over time by the signal chain itself, without instruments in between."""
    c = file.content
    target, world = target_of(file), simulated_world(file)
    if world.detector is not None:
        world = replace(world, ohmmeter_noise_dec=0.0)
    count = max(1, math.ceil(target.duration_s / c.experiment.period_s - 1e-9))
    time = np.asarray(np.arange(count) * c.experiment.period_s, dtype=np.float64)
    current = target.at(time)
    too_large = np.flatnonzero(np.abs(current) > c.limits.current_A)
    if too_large.size:
        k = int(too_large[0])
        text = f"at {time[k]:g} s {current[k]:g} A; expected within limits.current_A = {c.limits.current_A:g} A"
        raise fault(file.path, "experiment.target", text)
    test = _test_current(file, time)
    readings = simulate_record(world, time, current, meter_current_A=test)
    lost = np.flatnonzero(~np.isfinite(readings.temperature_degC))
    if lost.size:
        names = ", ".join(effect.name for effect in world.effects) or "none"
        text = f"from {time[lost[0]]:g} s on the simulated temperature is no number any more; effects: {names}"
        raise fault(file.path, "simulation", f"{text}; expected equations that stay finite")
    columns: dict[str, Array | list[str]] = {
        "time_s": time,
        "temperature_degC": readings.temperature_degC,
        "current_A": current,
    }
    if world.detector is not None:
        noise = np.random.default_rng(world.seed).standard_normal(count) * world.detector.noise_V
        columns[getattr(world.film, "output", "output")] = readings.output + noise / world.detector.volts_per_unit
    elif c.bench.meter is not None:
        columns |= {"resistance_ohm": readings.resistance_ohm, "meter_current_A": test}
    return Simulated(columns, world.effects)


def _test_current(file: ConfigurationFile, time: Array) -> Array:
    """Return the test current of each row (A): the target's column meter_current_A, or one for all rows."""
    c = file.content
    if c.bench.meter is None:
        return np.zeros(time.size)
    if isinstance(c.experiment.target, str):
        record = read_record(file.beside(c.experiment.target))
        if record.has("meter_current_A"):
            since = np.searchsorted(record["time_s"] - record["time_s"][0], time, side="right") - 1
            return np.nan_to_num(record["meter_current_A"])[since]
    chosen = c.simulation.meter_current_A
    return np.full(time.size, min(TEST_CURRENT_A, c.limits.meter_current_A) if chosen is None else chosen)


def _closed_loop(file: ConfigurationFile, say: Callable[[str], None], onlooker: Onlooker | None) -> Simulated:
    """Simulate through the instruments, byte for byte, as `peltier run` does it."""
    world, ended = simulated_world(file), None
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "run"
        try:
            run(file, folder, say, onlooker)
        except Tripped as trip:
            folder, ended = part_of(folder), trip
            if not (folder / "record.csv").is_file():
                raise
        record = read_record(folder / "record.csv")
    columns: dict[str, Array | list[str]] = {**record.columns, **record.text_columns}
    if record.has("resistance_time_s"):
        columns["resistance_time_s"] = stamp_s(world, record["resistance_time_s"])
    kept = {name: c for name, c in columns.items() if isinstance(c, list) or np.any(np.isfinite(c))}
    return Simulated(kept, world.effects, ended)
