"""The configuration of a bench and an experiment, as a checked TOML file.

Every key has its unit in its name and its default here; `peltier init` writes commented files to start from.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from rig.faults import Faults
from rig.files.model_file import MemorylessTable, PlateTable
from rig.files.toml_file import Table, checked, read_toml

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError("expected [low, high] with low < high")
    return pair


Range = Annotated[tuple[float, float], AfterValidator(_ordered)]


class ControllerTable(Table):
    """[bench.controller]: driver by name, port as pyserial opens it.

    options are the driver's own, such as an address or a model; baud changes the line's rate from the driver's.
    """

    driver: str
    port: str
    baud: int | None = Field(default=None, gt=0)
    options: dict[str, bool | int | float | str] = {}
    dead_man_s: Positive = 5.0


class MeterTable(Table):
    """[bench.meter]: four_wire, integration time in power-line cycles (nplc); options are the driver's own."""

    driver: str
    port: str
    baud: int | None = Field(default=None, gt=0)
    options: dict[str, bool | int | float | str] = {}
    four_wire: bool = True
    nplc: Positive = 1.0


class BenchTable(Table):
    """[bench]: time is "virtual" only with sim:// ports, and their default; else "real"."""

    time: Literal["real", "virtual"] | None = None
    controller: ControllerTable
    meter: MeterTable | None = None


class LimitsTable(Table):
    """[limits]: what the interlock trips on. stale_s: a reading older than this is none."""

    temperature_degC: Range = (5.0, 100.0)
    current_A: Positive
    meter_current_A: Positive = 1e-3
    stale_s: Positive = 2.0


class ExperimentTable(Table):
    """[experiment]: what to do. target: a CSV file, or a profile in words."""

    kind: Literal["track_resistance", "temperature_profile", "current_profile", "hold"] = "track_resistance"
    name: str = Field(default="run", pattern=r"^[A-Za-z0-9_.-]{1,40}$")
    target: str | list[str] | None = None
    model: str | None = None
    law: Literal["full", "pid", "feedforward", "instrument_pid"] = "full"
    period_s: Positive = 0.1
    compare: list[Literal["pid", "feedforward", "instrument_pid"]] = []
    settle_s: NotNegative = 10.0


class ControlTable(Table):
    """[control]: design of the laws.

    ms: largest sensitivity asked. dead_time_s: of the bench, one period where it is not given. disturbance_time_s: of
    the feedback of R, by default the closed-loop time of the temperature PID, which it must not outrun.
    """

    ms: Annotated[float, Field(gt=1.05, le=2.5)] = 1.4
    dead_time_s: NotNegative | None = None
    preview_s: Positive = 4.0
    band_dec: NotNegative | None = None
    disturbance_time_s: Positive | None = None
    rate_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9


class CalibrationTable(Table):
    """[calibration]: the profile that fixes film and plate, in a range of temperatures."""

    temperature_degC: Range | None = None
    transition_degC: Range | None = None
    rate_K_per_s: Positive = 1.0
    period_s: Positive = 0.25
    dwell_s: NotNegative = 4.0
    minor_loops: int = Field(default=14, ge=2, le=200)
    seed: int = Field(default=0, ge=0)


class RelayFilmTable(Table):
    """[simulation.film] kind = "preisach": a bell-shaped density of relays, see sim.films.preisach."""

    kind: Literal["preisach"] = "preisach"
    relays: int = Field(default=4000, ge=1)
    mean_degC: float = 61.0
    spread_K: Positive = 3.2
    halfwidth_K: Positive = 2.8
    halfwidth_sigma: Positive = 0.4
    decades: Positive = 2.0
    memoryless: MemorylessTable = MemorylessTable(function="tanh", amplitude=0.35, a=0.03, b=-1.65, offset=-5.0)
    seed: int = Field(default=1, ge=0)


class ModelFilmTable(Table):
    """[simulation.film] kind = "model": the film of a model file is the truth."""

    kind: Literal["model"]
    model: str


class HeatSinkTable(Table):
    """[simulation.heat_sink_warmup]: see sim.effects.heat_sink_warmup; without it the far side keeps the ambient."""

    sink_capacity_ratio: Positive
    sink_conductance_ratio_per_s: NotNegative


class SimulationTable(Table):
    """[simulation]: what is true of the simulated rig; the controller does not see it."""

    plate: PlateTable = PlateTable(
        seebeck_over_capacity_per_A_s=1.6e-3,
        resistance_over_capacity_K_per_A2_s=0.06,
        conductance_over_capacity_per_s=0.018,
        ambient_degC=25.0,
    )
    heat_sink_warmup: HeatSinkTable | None = None
    film: RelayFilmTable | ModelFilmTable = Field(default=RelayFilmTable(), discriminator="kind")
    first_degC: float = 25.0
    thermometer_noise_K: NotNegative = 0.005
    ohmmeter_noise_dec: NotNegative = 0.001
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="before")
    @classmethod
    def _default_kind(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("film"), dict):
            return {**data, "film": {"kind": "preisach", **data["film"]}}
        return data


class Configuration(Table):
    """A whole configuration file."""

    bench: BenchTable
    limits: LimitsTable
    experiment: ExperimentTable = ExperimentTable()
    control: ControlTable = ControlTable()
    calibration: CalibrationTable = CalibrationTable()
    simulation: SimulationTable = SimulationTable()

    @model_validator(mode="after")
    def _whole(self) -> Configuration:
        ports = [self.bench.controller.port] + ([self.bench.meter.port] if self.bench.meter else [])
        simulated = [port.startswith("sim://") for port in ports]
        if any(simulated) and not all(simulated):
            raise ValueError(f"bench: ports {', '.join(ports)}: expected all of them sim://, or none")
        if self.bench.time == "virtual" and not all(simulated):
            raise ValueError("bench.time: 'virtual' goes only with sim:// ports; expected 'real'")
        if self.experiment.kind == "track_resistance" and self.bench.meter is None:
            raise ValueError("bench.meter: missing; expected a meter for kind 'track_resistance'")
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


def read_configuration(path: Path) -> ConfigurationFile:
    """Read and check a configuration. Raises Faults with a line for each fault."""
    raw = read_toml(path)
    content = checked(Configuration, raw, path)
    file = ConfigurationFile(path, path.read_text(encoding="utf-8"), content)
    lines = []
    for key, name in (("experiment.model", content.experiment.model), ("experiment.target", content.experiment.target)):
        if isinstance(name, str) and not file.beside(name).is_file():
            lines.append(f"{path}: {key}: {name!r}: no such file beside the configuration")
    low, high = content.limits.temperature_degC
    span = content.calibration.temperature_degC
    if span is not None and not (low <= span[0] and span[1] <= high):
        lines.append(
            f"{path}: calibration.temperature_degC: {list(span)}: "
            f"expected within limits.temperature_degC [{low}, {high}]"
        )
    if not math.isfinite(low + high):
        lines.append(f"{path}: limits.temperature_degC: expected finite numbers")
    lines += _unknown_drivers(path, content)
    if lines:
        raise Faults(lines)
    return file


def _unknown_drivers(path: Path, content: Configuration) -> list[str]:
    """A line for each driver that does not exist."""
    from rig.drivers.registry import CONTROLLERS, METERS

    bench = content.bench
    roles = [("controller", bench.controller.driver, CONTROLLERS)]
    if bench.meter is not None:
        roles.append(("meter", bench.meter.driver, METERS))
    lines = []
    for role, name, known in roles:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            lines.append(f"{path}: bench.{role}.driver: {name!r}: {hint}expected one of {', '.join(sorted(known))}")
    return lines
