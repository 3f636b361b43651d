"""The configuration of a bench and an experiment, as a checked TOML file.

Every key has its unit in its name and its default here; `peltier init` writes commented files to start from.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import model_validator

from rig.config.configuration_text import without_secrets
from rig.config.schema import Table, checked
from rig.config.tables import (
    BenchTable,
    CalibrationTable,
    ControlTable,
    EpicsTable,
    ExperimentTable,
    LimitsTable,
    ServeTable,
    SimulationTable,
    SweepTable,
)
from rig.config.toml_file import parsed_toml, read_text
from rig.core.faults import Faults


class Configuration(Table):
    """A whole configuration file."""

    bench: BenchTable
    limits: LimitsTable
    experiment: ExperimentTable = ExperimentTable()
    control: ControlTable = ControlTable()
    calibration: CalibrationTable = CalibrationTable()
    simulation: SimulationTable = SimulationTable()
    sweep: SweepTable = SweepTable()
    serve: ServeTable = ServeTable()
    epics: EpicsTable = EpicsTable()

    @model_validator(mode="after")
    def _whole(self) -> Configuration:
        ports = [self.bench.controller.port] + ([self.bench.meter.port] if self.bench.meter else [])
        simulated = [port.startswith("sim://") for port in ports]
        if any(simulated) and not all(simulated):
            raise ValueError(f"bench: ports {', '.join(ports)}: expected all of them sim://, or none")
        if self.bench.time == "virtual" and not all(simulated):
            raise ValueError("bench.time: 'virtual' goes only with sim:// ports; expected 'real'")
        kind, meter = self.experiment.kind, self.bench.meter
        if kind in ("track_resistance", "track_output") and meter is None:
            raise ValueError(f"bench.meter: missing; expected a meter for kind {kind!r}")
        if kind == "track_output" and meter is not None and meter.output is None:
            text = "expected 'voltage', with output and formula, for kind 'track_output'"
            raise ValueError(f"bench.meter.quantity: {meter.quantity!r}; {text}")
        return self

    @property
    def simulated(self) -> bool:
        return self.bench.controller.port.startswith("sim://")

    @property
    def virtual_time(self) -> bool:
        return self.simulated and self.bench.time != "real"


@dataclass(frozen=True)
class ConfigurationFile:
    """A configuration with the file that it came from; paths in it are relative to that file."""

    path: Path
    text: str
    content: Configuration

    def beside(self, name: str) -> Path:
        """A path from the configuration, relative to its file."""
        return self.path.parent / name


def read_configuration(path: Path, for_experiment: bool = True) -> ConfigurationFile:
    """Read and check a configuration. Raises Faults with a line for each fault.

    for_experiment: whether its experiment is to be done, which needs the files of its target and its model.
    """
    text = read_text(path)
    return configuration_of(path, text, parsed_toml(text, path), for_experiment)


def configuration_of(path: Path, text: str, raw: dict[str, Any], for_experiment: bool = True) -> ConfigurationFile:
    """A configuration from its text and what TOML makes of it, as if it were at `path`. Raises Faults.

    The text that it keeps, and that run folders and people get, is without the secrets of [serve].
    """
    content = checked(Configuration, _with_own_drivers(path, raw), path)
    file = ConfigurationFile(path, without_secrets(text), content)
    lines = []
    for key, name in (("experiment.model", content.experiment.model), ("experiment.target", content.experiment.target)):
        if for_experiment and isinstance(name, str) and not file.beside(name).is_file():
            lines.append(f"{path}: {key}: {name!r}: no such file beside the configuration")
    lines += _ranges_outside(path, content)
    lines += _slow_periods(path, content)
    lines += _unknown_drivers(path, content)
    lines += _effect_faults(file)
    if lines:
        raise Faults(lines)
    return file


def _ranges_outside(path: Path, content: Configuration) -> list[str]:
    """A line for each range of a calibration that is not inside the one around it."""
    lines = []
    around, (low, high) = "limits.temperature_degC", content.limits.temperature_degC
    for key in ("temperature_degC", "transition_degC"):
        span = getattr(content.calibration, key)
        if span is None:
            continue
        if not (low <= span[0] and span[1] <= high):
            lines.append(f"{path}: calibration.{key}: {list(span)}: expected within {around} [{low}, {high}]")
        around, (low, high) = f"calibration.{key}", span
    return lines


def _slow_periods(path: Path, content: Configuration) -> list[str]:
    """A line for each period, and for a number of integrations, that a bench cannot be watched with: one reading may
    fail, and the next is in time."""
    from rig.drivers.meter import LINE_PERIOD_S

    longest_s, bound = 0.5 * content.limits.stale_s, "limits.stale_s"
    dead_man_s = content.bench.controller.dead_man_s
    if 0.0 < 0.5 * dead_man_s < longest_s:
        longest_s, bound = 0.5 * dead_man_s, "bench.controller.dead_man_s"
    periods = (("experiment", content.experiment.period_s), ("calibration", content.calibration.period_s))
    lines = [
        f"{path}: {table}.period_s: {period_s:g}: expected at most {longest_s:g}, half of {bound}"
        for table, period_s in periods
        if period_s > longest_s
    ]
    meter = content.bench.meter
    if meter is None or (meter.average or 1) * meter.nplc * LINE_PERIOD_S <= longest_s:
        return lines
    key, most = ("nplc", meter.nplc), longest_s / LINE_PERIOD_S
    if meter.average is not None and meter.nplc <= most:
        key, most = ("average", meter.average), most // meter.nplc
    text = f"expected at most {most:g}, for readings of {longest_s:g} s, half of {bound}"
    return [*lines, f"{path}: bench.meter.{key[0]}: {key[1]:g}: {text}"]


def _effect_faults(file: ConfigurationFile) -> list[str]:
    """Make the effects of the user's own known; a line for each fault in what is switched on."""
    table = file.content.simulation
    if not (table.effects or table.effect_files):
        return []
    from rig.config.effect_tables import add_effect_files, switched_effects

    try:
        add_effect_files(file.beside(name) for name in table.effect_files)
    except Faults as faults:
        return faults.lines
    sink = [{"name": "heat_sink_warmup"}] if table.heat_sink_warmup is not None else []
    return switched_effects([*table.effects, *sink], f"{file.path}: simulation.effects", complete=False)[1]


def _with_own_drivers(path: Path, raw: dict[str, Any]) -> dict[str, Any]:
    """The same, with the files of drivers of the user's own taken from beside the configuration."""
    from rig.drivers.registry import beside

    bench = raw.get("bench")
    if not isinstance(bench, dict):
        return raw
    found = dict(bench)
    for role in ("controller", "meter"):
        table = bench.get(role)
        if isinstance(table, dict) and isinstance(table.get("driver"), str):
            found[role] = {**table, "driver": beside(table["driver"], path.parent)}
    return {**raw, "bench": found}


def _unknown_drivers(path: Path, content: Configuration) -> list[str]:
    """A line for each driver that does not exist."""
    from rig.drivers.registry import CONTROLLERS, METERS, is_own

    bench = content.bench
    roles = [("controller", bench.controller.driver, CONTROLLERS)]
    if bench.meter is not None:
        roles.append(("meter", bench.meter.driver, METERS))
    lines = []
    for role, name, known in roles:
        if is_own(name):
            if not Path(name.rpartition(":")[0]).is_file():
                lines.append(f"{path}: bench.{role}.driver: {name!r}: there is no such file")
        elif name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            lines.append(f"{path}: bench.{role}.driver: {name!r}: {hint}expected one of {', '.join(sorted(known))}")
    return lines
