"""The configuration of a bench and an experiment, as a checked TOML file.

Every key has its unit in its name and its default here; `peltier init` writes commented files to start from.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from rig.core.faults import Faults
from rig.files.bounded_numbers import Limits, NotNegative, Period, Positive, Range, Span, Wait
from rig.files.epics_table import EpicsTable
from rig.files.secret_keys import without_secrets
from rig.files.serve_table import ServeTable
from rig.files.simulation_table import SimulationTable
from rig.files.sweep_table import SweepTable
from rig.files.toml_file import Table, checked
from rig.files.toml_text import parsed_toml, read_text

SMALLEST_PULSE = 0.01  # of the current limit: such a pulse takes four minutes to put in what moves a plate


class InstrumentTable(Table):
    """An instrument: driver by name, port as pyserial opens it.

    options are the driver's own, such as an address or a model; baud changes the line's rate from the driver's.
    serial_number: the instrument's own; nothing runs where another one answers.
    """

    driver: str
    port: str
    baud: int | None = Field(default=None, gt=0, le=100_000_000)
    options: dict[str, bool | int | float | str] = {}
    serial_number: str | None = None


class ControllerTable(InstrumentTable):
    """[bench.controller]: dead_man_s, after which without a word from us the controller switches itself off."""

    dead_man_s: Span = 5.0


class MeterTable(InstrumentTable):
    """[bench.meter]: four_wire, integration time in power-line cycles (nplc), integrations that a reading is the mean
    of (average; left out, as many as a period has room for).

    With quantity "voltage" a voltage in a range of range_V stands for the film's output (its name and unit, as in
    "curvature_per_m"), by a formula of voltage_V: "(voltage_V - 0.131) * 22.4" (rig.drivers.formula).
    """

    four_wire: bool = True
    nplc: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    average: Annotated[int | None, Field(ge=1, le=100)] = None
    quantity: Literal["resistance", "voltage"] = "resistance"
    output: str | None = None
    formula: str | None = None
    range_V: Positive = 10.0

    @model_validator(mode="after")
    def _whole(self) -> MeterTable:
        from rig.drivers.formula import check_output, formula

        given = [name for name in ("output", "formula") if getattr(self, name) is not None]
        if self.quantity == "resistance":
            if given:
                raise ValueError(f"{', '.join(given)}: expected with quantity = 'voltage' only")
            return self
        if self.formula is None or self.output is None:
            raise ValueError("formula, output: expected with quantity = 'voltage'")
        formula(self.formula)
        check_output(self.output)
        self.options.update(formula=self.formula, output=self.output, range_V=self.range_V)
        return self


class BenchTable(Table):
    """[bench]: time is "virtual" only with sim:// ports, and their default; else "real"."""

    time: Literal["real", "virtual"] | None = None
    controller: ControllerTable
    meter: MeterTable | None = None


def _pulse(share: float) -> float:
    """The share of the current limit, if it is none or makes a pulse that ends. Raises ValueError."""
    if 0.0 < share < SMALLEST_PULSE:
        raise ValueError(f"expected 0 (no pulse), or {SMALLEST_PULSE:g} to 1: a smaller one moves no plate")
    return share


class LimitsTable(Table):
    """[limits]: what the interlock trips on. stale_s: a reading older than this is none.

    rate_K_per_s: faster than any plate; a reading that moved by more is none. runaway_s: for how long the plate may
    move against the current, or not at all. polarity_share: of current_A, for the pulse before a run; 0: no pulse.
    """

    temperature_degC: Limits = (5.0, 100.0)
    current_A: Positive
    meter_current_A: Positive = 1e-3
    stale_s: Span = 2.0
    rate_K_per_s: Positive = 20.0
    runaway_s: Span = 20.0
    polarity_share: Annotated[float, Field(ge=0.0, le=1.0), AfterValidator(_pulse)] = 0.25


TrackingLaw = Literal["full", "pid", "feedforward", "instrument_pid"]
Kind = Literal["track_resistance", "track_output", "temperature_profile", "current_profile", "hold"]


class ExperimentTable(Table):
    """[experiment]: what to do. target: a CSV file, or a profile in words. "track_output": of the quantity that the
    meter's voltage stands for.

    repeat: of a resistance that is tracked, how often; each repetition knows of what the model lacked in those
    before. learned: the folder of a run whose learned.csv the first one begins with. memory: what is known of the film
    at first: "condition" drives it to the hot end, so that all is; "estimate" begins where it is and lets the readings
    tell; "assume" begins where it is with the model's `initial`.
    """

    kind: Kind = "track_resistance"
    name: str = Field(default="run", pattern=r"^[A-Za-z0-9_.-]{1,40}$")
    target: str | list[str] | None = None
    model: str | None = None
    law: TrackingLaw = "full"
    period_s: Period = 0.1
    compare: list[Literal["pid", "feedforward", "instrument_pid"]] = []
    settle_s: Wait = 10.0
    repeat: Annotated[int, Field(ge=1, le=100)] = 1
    learned: str | None = None
    memory: Literal["condition", "estimate", "assume"] = "condition"

    @property
    def laws(self) -> tuple[TrackingLaw, ...]:
        """Those that track the target, each once: the run's own, then those to compare it with."""
        return tuple(dict.fromkeys((self.law, *self.compare)))


class ControlTable(Table):
    """[control]: design of the laws.

    ms: largest sensitivity asked of a PID; with 1.42 that of the whole law stays below 1.6 with a film 0.6 times as
    steep as the model's, with less it does not. dead_time_s: of the bench, one period where it is not given. band_dec:
    a difference for which the resistance does not turn round, at the least; what noise makes of it the run estimates.
    most_share: of what the ohmmeter is off the model, that one reading may change the law's correction by; 0.35 is what
    the margins of the whole law allow at a period of 0.1 s (`peltier tune` says it of any other).
    preview_s: how far a law looks ahead, as long as the plate takes across the film's loop where it is not given.
    rate_share: of the plate's fastest rates, for ramps of temperature; a resistance has all of them where it is not
    given.
    """

    ms: Annotated[float, Field(gt=1.05, le=2.5)] = 1.42
    dead_time_s: Annotated[float, Field(ge=0.0, le=3600.0)] | None = None
    preview_s: Annotated[float, Field(ge=1e-3, le=3600.0)] | None = None
    band_dec: NotNegative = 0.0
    rate_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9
    most_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.35

    @property
    def resistance_rate_share(self) -> float:
        """The same for a resistance: its reference begins anew each period, and needs no reserve."""
        return self.rate_share if "rate_share" in self.model_fields_set else 1.0


class CalibrationTable(Table):
    """[calibration]: the profile that fixes film and plate, in a range of temperatures."""

    temperature_degC: Range | None = None
    transition_degC: Range | None = None
    rate_K_per_s: Positive = 1.0
    period_s: Period = 0.25
    dwell_s: Wait = 4.0
    minor_loops: int = Field(default=14, ge=2, le=200)
    seed: int = Field(default=0, ge=0)


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
    from rig.files.effect_tables import add_effect_files, switched_effects

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
