"""The tables of a configuration: every key has its unit in its name and its default here."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, SecretStr, model_validator

from rig.config.model_file import MemorylessTable, PlateTable
from rig.config.schema import (
    LARGEST,
    Count,
    Days,
    HostName,
    Limits,
    NotNegative,
    Number,
    Period,
    Positive,
    Range,
    Span,
    Table,
    Wait,
)

SMALLEST_PULSE = 0.01  # of the current limit: such a pulse takes four minutes to move a plate
MOST_CASES = 1_000_000  # of a sweep
PREFIX = r"^[A-Za-z0-9_.:-]{1,40}$"  # of EPICS names, which have room for 60 characters; ours need 20
TrackingLaw = Literal["full", "pid", "feedforward", "instrument_pid"]
ExperimentKind = Literal["track_resistance", "track_output", "temperature_profile", "current_profile", "hold"]
SweepTask = Literal["experiment", "identification", "diagnosis"]
TcpPort = Annotated[int, Field(ge=1024, le=65534)]  # the one after it is used as well
Share = Annotated[float, Field(gt=0.0, le=1.0)]


def _check_web_address(secret: SecretStr) -> SecretStr:
    if not re.fullmatch(r"https?://[!-~]+", secret.get_secret_value()):
        raise ValueError("expected an address that begins with http:// or https://")
    return secret


def _check_pulse(share: float) -> float:
    if 0.0 < share < SMALLEST_PULSE:
        raise ValueError(f"expected 0 (no pulse), or {SMALLEST_PULSE:g} to 1: a smaller one moves no plate")
    return share


def _check_ipv4(text: str) -> str:
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        raise ValueError("expected an IPv4 address, as in 127.0.0.1; 0.0.0.0: every interface") from None
    return text


def _check_name(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_.-]{1,64}", text):
        raise ValueError("expected a name of letters, digits and _ . -")
    return text


Token = Annotated[SecretStr, Field(min_length=16)]
Name = Annotated[str, AfterValidator(_check_name)]


class InstrumentTable(Table):
    """An instrument: driver by name, port as pyserial opens it.

    options: of the driver, such as an address or a model. baud: the line's rate, if not the driver's. serial_number: of
    the instrument; nothing runs if another one answers.
    """

    driver: str
    port: str
    baud: int | None = Field(default=None, gt=0, le=100_000_000)
    options: dict[str, bool | int | float | str] = {}
    serial_number: str | None = None


class ControllerTable(InstrumentTable):
    """[bench.controller]; dead_man_s: the controller switches itself off after so long without a message from us."""

    dead_man_s: Span = 5.0


class MeterTable(InstrumentTable):
    """[bench.meter]; nplc: integration time in power-line cycles; average: integrations in a reading, by default as
    many as a period has room for.

    With quantity "voltage" a voltage in a range of range_V stands for the film's output (its name and unit, as in
    "curvature_per_m"), by a formula of voltage_V: "(voltage_V - 0.131) * 22.4" (rig.drivers.meter).
    """

    four_wire: bool = True
    nplc: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0
    average: Annotated[int | None, Field(ge=1, le=100)] = None
    quantity: Literal["resistance", "voltage"] = "resistance"
    output: str | None = None
    formula: str | None = None
    range_V: Positive = 10.0

    @model_validator(mode="after")
    def _check(self) -> MeterTable:
        from rig.drivers.meter import check_output, formula

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
    """[bench]; time: "virtual" (only with sim:// ports, and their default) or "real"."""

    time: Literal["real", "virtual"] | None = None
    controller: ControllerTable
    meter: MeterTable | None = None


class LimitsTable(Table):
    """[limits]: bounds beyond which the interlock switches off.

    stale_s: an older reading does not count. rate_K_per_s: faster than any plate; a reading that moved by more does not
    count. runaway_s: for so long the plate may move against the current, or not at all. polarity_share: of current_A,
    for the pulse before a run; 0: no pulse.
    """

    temperature_degC: Limits = (5.0, 100.0)
    current_A: Positive
    meter_current_A: Positive = 1e-3
    stale_s: Span = 2.0
    rate_K_per_s: Positive = 20.0
    runaway_s: Span = 20.0
    polarity_share: Annotated[float, Field(ge=0.0, le=1.0), AfterValidator(_check_pulse)] = 0.25


class ExperimentTable(Table):
    """[experiment]; target: a CSV file, or a profile in words. Kind "track_output" tracks the quantity that the meter's
    voltage stands for.

    repeat: repetitions of a resistance that is tracked, each corrected for what the film model lacked in those before;
    not of law "pid", nor with an effect on the ohmmeter.
    learned: folder of a run whose learned.csv corrects the first. memory: of the film at first: "condition" drives it
    to the hot end, so that it is known; "estimate" fits it to the readings; "assume" takes the model's `initial`.
    """

    kind: ExperimentKind = "track_resistance"
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
        """The laws that track the target, each once: the run's own, then those to compare it with."""
        return tuple(dict.fromkeys((self.law, *self.compare)))


class ControlTable(Table):
    """[control]: design of the laws.

    ms: largest sensitivity of a PID; with 1.42 that of the whole law stays below 1.6 for a film 0.6 times as steep as
    the model's. dead_time_s: of the bench, by default one period. most_share: of the difference between ohmmeter and
    model, that one reading may change the law's correction by; 0.35 is what the margins of the whole law allow at a
    period of 0.1 s (`peltier tune` computes it for others). preview_s: how far a law looks ahead, by default as long as
    the plate takes across the film's loop. rate_share: of the plate's fastest rates, for ramps of temperature.
    """

    ms: Annotated[float, Field(gt=1.05, le=2.5)] = 1.42
    dead_time_s: Annotated[float, Field(ge=0.0, le=3600.0)] | None = None
    preview_s: Annotated[float, Field(ge=1e-3, le=3600.0)] | None = None
    rate_share: Share = 0.9
    most_share: Share = 0.35

    @property
    def resistance_rate_share(self) -> float:
        """The rate_share for a resistance, by default 1: its reference is computed anew each period."""
        return self.rate_share if "rate_share" in self.model_fields_set else 1.0


class CalibrationTable(Table):
    """[calibration]: the profile to which film and plate are fitted, within a range of temperatures."""

    temperature_degC: Range | None = None
    transition_degC: Range | None = None
    rate_K_per_s: Positive = 1.0
    period_s: Period = 0.25
    dwell_s: Wait = 4.0
    minor_loops: int = Field(default=14, ge=2, le=200)
    seed: int = Field(default=0, ge=0)


class RelayFilmTable(Table):
    """[simulation.film] kind = "preisach": a bell-shaped density of relays, see sim.world.films."""

    kind: Literal["preisach"] = "preisach"
    relays: Count = 16_000
    mean_degC: Number = 61.0
    spread_K: Positive = 3.2
    halfwidth_K: Positive = 2.8
    halfwidth_sigma: Positive = 0.4
    decades: Positive = 2.0
    memoryless: MemorylessTable = MemorylessTable(function="tanh", amplitude=0.35, a=0.03, b=-1.65, offset=-5.0)
    seed: int = Field(default=1, ge=0)


class ModelFilmTable(Table):
    """[simulation.film] kind = "model": the film of a model file."""

    kind: Literal["model"]
    model: str


class HeatSinkTable(Table):
    """[simulation.heat_sink_warmup]: see sim.effects.heat_sink_warmup; without it the far side keeps the ambient."""

    sink_capacity_ratio: Positive
    sink_conductance_ratio_per_s: NotNegative


class DetectorTable(Table):
    """[simulation.detector]: a voltmeter's reading of the film's output, see sim.world.plant."""

    volts_per_unit: Number
    offset_V: Number = 0.0
    noise_V: NotNegative = 0.0


class SimulationTable(Table):
    """[simulation]: the true properties of the simulated rig, which the controller does not see.

    effects: tables with a name of the catalogue and its parameters, each by default the middle of its typical range.
    effect_files: Python files beside this one with user-defined effects, see docs/own_effect.md. meter_current_A: the
    ohmmeter's, if `simulate` has no instruments (a current_profile without that column).
    """

    plate: PlateTable = PlateTable(
        seebeck_over_capacity_per_A_s=1.6e-3,
        resistance_over_capacity_K_per_A2_s=0.06,
        conductance_over_capacity_per_s=0.018,
        ambient_degC=25.0,
    )
    heat_sink_warmup: HeatSinkTable | None = None
    effects: list[dict[str, float | str]] = []
    effect_files: list[str] = []
    meter_current_A: NotNegative | None = None
    film: RelayFilmTable | ModelFilmTable = Field(default=RelayFilmTable(), discriminator="kind")
    detector: DetectorTable | None = None
    first_degC: Number = 25.0
    thermometer_noise_K: NotNegative = 0.005
    ohmmeter_noise_dec: NotNegative = 0.001
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="before")
    @classmethod
    def _add_default_kind(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("film"), dict):
            return {**data, "film": {"kind": "preisach", **data["film"]}}
        return data


class ServeTable(Table):
    """[serve]: the bench daemon, see docs/daemon.md.

    folder: of run folders and history.sqlite, by default runs/ where the daemon was started. configurations: folder of
    those that may be started, by default this file's. token: opens the page and the interface, on the loopback too; a
    must beyond the loopback. metrics_token: opens /metrics and nothing else. hosts: further names or origins
    ("https://bench.lab.example") by which browsers reach it. port 0: any that is free. stop_port: of the listener for
    STOP alone, by default the one after `port`. diagnose: "nightly" runs `peltier trend` on the runs from diagnose_hour
    on, while no run is going on.
    """

    name: str = Field(default="bench", pattern=r"^[A-Za-z0-9_-]{1,40}$")
    address: str = "127.0.0.1"
    port: int = Field(default=8765, ge=0, le=65535)
    stop_port: int | None = Field(default=None, ge=0, le=65535)
    token: Token | None = None
    metrics_token: Token | None = None
    hosts: list[HostName] = []
    folder: str | None = None
    configurations: str = "."
    idle_period_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    raw_days: Days = 30.0
    minute_days: Days = 400.0
    hour_days: Days = 4000.0
    webhook: Annotated[SecretStr, AfterValidator(_check_web_address)] | None = None
    diagnose: Literal["never", "nightly"] = "never"
    diagnose_hour: Annotated[int, Field(ge=0, le=18)] = 3


class SweepTable(Table):
    """[sweep]: the cases of `peltier sweep`.

    what: the experiment alone, or identification or diagnosis of its record. records: files to identify or to diagnose
    in place of simulated experiments; names with * and ? beside this file. plan: "grid", every value with every other,
    or "latin_hypercube", `samples` points in `ranges`. seeds: of the noise, a list or how many; a Latin hypercube takes
    one for each point. effects: alternatives, each a list of effects as in `simulate --effect`. parameters: values for
    keys of this file, as in "control.ms" = [1.2, 1.4]. ranges: of a Latin hypercube, [low, high] of a key. plan_seed:
    of its points.
    """

    what: SweepTask = "experiment"
    records: list[str] = []
    plan: Literal["grid", "latin_hypercube"] = "grid"
    seeds: Annotated[int, Field(ge=0, le=MOST_CASES)] | list[int] = Field(default=1)
    effects: list[list[str]] = [[]]
    parameters: dict[str, list[Any]] = {}
    ranges: dict[str, tuple[Annotated[float, Field(ge=-LARGEST, le=LARGEST)], Annotated[float, Field(le=LARGEST)]]] = {}
    samples: Annotated[int, Field(ge=1, le=MOST_CASES)] | None = None
    plan_seed: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _check_plan(self) -> SweepTable:
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
    """The table [sweep] of a configuration, so that its faults name the table."""

    sweep: SweepTable


class EpicsTable(Table):
    """[epics]: the EPICS server of `peltier epics`, see docs/epics.md.

    prefix: of the records' names, before a colon, by default serve.name. address: to listen at; beyond the loopback
    everybody there can read, and STOP. ca_port: Channel Access, TCP and UDP. pva_port: PV Access, TCP; the one after it
    is UDP, for searches. write: offer records that start and reset, to `users` on `hosts` (an empty list is anybody;
    both empty are refused).
    """

    prefix: str | None = Field(default=None, pattern=PREFIX)
    address: Annotated[str, AfterValidator(_check_ipv4)] = "127.0.0.1"
    ca_port: TcpPort = 5064
    pva_port: TcpPort = 5075
    write: bool = False
    users: list[Name] = []
    hosts: list[Name] = []

    @model_validator(mode="after")
    def _check_writers(self) -> EpicsTable:
        if self.write and not (self.users or self.hosts):
            raise ValueError("users, hosts: missing; expected who may write, with write = true")
        return self
