"""The configuration of a bench and an experiment: a TOML file, checked. `peltier init` writes commented ones."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import model_validator

from rig.config.schema import Table, validate
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
from rig.config.toml_file import parsed_toml, read_text, without_secrets
from rig.core.faults import Faults
from rig.core.reading import Identity


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
    def _check(self) -> Configuration:
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
    """A configuration with its file; text: the file's, without secrets."""

    path: Path
    text: str
    content: Configuration

    def beside(self, name: str) -> Path:
        """Return a path of the configuration, relative to its file."""
        return self.path.parent / name

    def strangers(self, identities: Mapping[str, Identity]) -> list[str]:
        """Return a line for each instrument whose serial number is not the configured one: two USB adapters may have
        changed places, and with them two benches."""
        tables = {"controller": self.content.bench.controller, "meter": self.content.bench.meter}
        lines = []
        for role, identity in identities.items():
            table = tables[role]
            if table is not None and table.serial_number not in (None, identity.serial_number):
                expected = f"{table.serial_number!r}: what answers at {table.port} is {identity}"
                lines.append(f"{self.path}: bench.{role}.serial_number: {expected}")
        return lines


def read_configuration(path: Path, for_experiment: bool = True) -> ConfigurationFile:
    """Return a checked configuration. Raises Faults with a line for each fault.

    for_experiment: the experiment is going to run, so that its target and its model have to be there.
    """
    text = read_text(path)
    return configuration_of(path, text, parsed_toml(text, path), for_experiment)


def configuration_of(path: Path, text: str, raw: dict[str, Any], for_experiment: bool = True) -> ConfigurationFile:
    """Return the configuration in a text and its TOML tables, as if it were at `path`. Raises Faults."""
    content = validate(Configuration, _with_driver_paths(path, raw), path)
    file = ConfigurationFile(path, without_secrets(text), content)
    lines = [f"{path}: {line}" for line in _faults(file, for_experiment)] + _effect_faults(file)
    if lines:
        raise Faults(lines)
    return file


def _faults(file: ConfigurationFile, for_experiment: bool) -> Iterator[str]:
    """Yield a line for each key that does not fit the files or the other keys."""
    content = file.content
    for key, name in (("experiment.model", content.experiment.model), ("experiment.target", content.experiment.target)):
        if for_experiment and isinstance(name, str) and not file.beside(name).is_file():
            yield f"{key}: {name!r}: no such file beside the configuration"
    around, (low, high) = "limits.temperature_degC", content.limits.temperature_degC
    for key in ("temperature_degC", "transition_degC"):
        span = getattr(content.calibration, key)
        if span is not None:
            if not (low <= span[0] and span[1] <= high):
                yield f"calibration.{key}: {list(span)}: expected within {around} [{low}, {high}]"
            around, (low, high) = f"calibration.{key}", span
    yield from _long_periods(content)
    yield from _unknown_drivers(content)


def _long_periods(content: Configuration) -> Iterator[str]:
    """Yield a line for each period, and for a reading, that is too long for the watch: if one reading fails, the next
    one has to be in time."""
    from rig.drivers.meter import LINE_PERIOD_S

    longest_s, bound = 0.5 * content.limits.stale_s, "limits.stale_s"
    dead_man_s = content.bench.controller.dead_man_s
    if 0.0 < 0.5 * dead_man_s < longest_s:
        longest_s, bound = 0.5 * dead_man_s, "bench.controller.dead_man_s"
    for table in ("experiment", "calibration"):
        period_s = getattr(content, table).period_s
        if period_s > longest_s:
            yield f"{table}.period_s: {period_s:g}: expected at most {longest_s:g}, half of {bound}"
    meter = content.bench.meter
    if meter is not None and (meter.average or 1) * meter.nplc * LINE_PERIOD_S > longest_s:
        key, value, most = "nplc", meter.nplc, longest_s / LINE_PERIOD_S
        if meter.average is not None and meter.nplc <= most:
            key, value, most = "average", meter.average, most // meter.nplc
        text = f"expected at most {most:g}, for readings of {longest_s:g} s, half of {bound}"
        yield f"bench.meter.{key}: {value:g}: {text}"


def _unknown_drivers(content: Configuration) -> Iterator[str]:
    from rig.drivers.registry import CONTROLLERS, METERS, is_own

    bench = content.bench
    for role, table, known in (("controller", bench.controller, CONTROLLERS), ("meter", bench.meter, METERS)):
        name = table.driver if table is not None else None
        if name is None or name in known:
            continue
        if not is_own(name):
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            yield f"bench.{role}.driver: {name!r}: {hint}expected one of {', '.join(sorted(known))}"
        elif not Path(name.rpartition(":")[0]).is_file():
            yield f"bench.{role}.driver: {name!r}: there is no such file"


def _effect_faults(file: ConfigurationFile) -> list[str]:
    """Load the user-defined effects, and return a line for each fault in the effects that are switched on."""
    table = file.content.simulation
    if not (table.effects or table.effect_files):
        return []
    from rig.config.effect_tables import add_effect_files, switch_effects

    try:
        add_effect_files(file.beside(name) for name in table.effect_files)
    except Faults as faults:
        return faults.lines
    sink = [{"name": "heat_sink_warmup"}] if table.heat_sink_warmup is not None else []
    return switch_effects([*table.effects, *sink], f"{file.path}: simulation.effects", complete=False)[1]


def _with_driver_paths(path: Path, raw: dict[str, Any]) -> dict[str, Any]:
    """Return the tables with the files of user-defined drivers as paths beside the configuration."""
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
