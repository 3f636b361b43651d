"""Model files: film, plate and effects as TOML, read and written to the same bits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tomli_w
from pydantic import Field, model_validator

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memoryless
from compensator.thermal.plate import LARGEST_SLOPE_PER_K, PlateModel
from rig.config.schema import Table, validate
from rig.config.toml_file import read_toml
from rig.core.faults import Faults
from rig.core.file_writing import write_text
from rig.records.film_output import FALLING_RESISTANCE

if TYPE_CHECKING:
    from sim.effects.effect import Switched
    from sim.model.film_mixing import PhaseMixing

LARGEST = 1e9  # beyond it a number is a slip of the pen, and its square may overflow
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
Temperature = Annotated[float, Field(ge=-273.15, le=LARGEST)]
Slope = Annotated[float, Field(ge=-LARGEST_SLOPE_PER_K, le=LARGEST_SLOPE_PER_K)]
Drive = Literal["current", "temperature"]


class EnvelopeTable(Table):
    """gamma(v) = f(a v + b), v in degC: paper eqs (28), (29)."""

    function: Literal["tanh", "erf", "arctan", "linear"]
    a: float = Field(gt=0.0, le=LARGEST)
    b: Number

    def envelope(self) -> Envelope:
        return Envelope(self.function, self.a, self.b)


class MemorylessTable(Table):
    """D(v), in the output's unit: paper eqs (30), (31)."""

    function: Literal["none", "tanh", "sin", "cos", "linear", "polynomial", "arrhenius"] = "none"
    amplitude: Number = 0.0
    a: Number = 1.0
    b: Number = 0.0
    offset: Number = 0.0
    coefficients: list[Number] = []

    def memoryless(self) -> Memoryless:
        return Memoryless(self.function, self.amplitude, self.a, self.b, self.offset, tuple(self.coefficients))


class OperatorTable(Table):
    """One operator of kind "mixed_envelopes"."""

    radius: NotNegative
    weight: NotNegative
    rising: EnvelopeTable
    falling: EnvelopeTable


class MixingTable(Table):
    """[film.mixing]: how the conductivities of the phases add up (`sim.model.film_mixing`), if not as logarithms;
    low_dec, high_dec: output of a film that is all insulator and all metal."""

    exponent: Annotated[float, Field(ge=-10.0, le=10.0)]
    percolation: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    low_dec: Number
    high_dec: Number

    @model_validator(mode="after")
    def _check(self) -> MixingTable:
        if not self.low_dec < self.high_dec:
            raise ValueError(f"low_dec: {self.low_dec!r}: expected less than high_dec, {self.high_dec!r}")
        return self

    def mixing(self) -> PhaseMixing:
        from sim.model.film_mixing import PhaseMixing

        return PhaseMixing(self.low_dec, self.high_dec, self.exponent, self.percolation)


class FilmTable(Table):
    """[film]."""

    kind: Literal["extended_generalized_pi", "generalized_pi", "classical_pi", "mixed_envelopes"]
    output: str = "minus_log10_ohm"
    radii: list[NotNegative] = []
    weights: list[NotNegative] = []
    initial: Literal["cooled", "heated"] = "cooled"
    rising: EnvelopeTable | None = None
    falling: EnvelopeTable | None = None
    memoryless: MemorylessTable = MemorylessTable()
    operators: list[OperatorTable] = []
    mixing: MixingTable | None = None

    @model_validator(mode="after")
    def _check(self) -> FilmTable:
        if self.kind == "mixed_envelopes":
            if not self.operators:
                raise ValueError("operators: missing; kind 'mixed_envelopes' needs [[film.operators]]")
        elif not self.radii:
            raise ValueError("radii: missing; expected a list of numbers >= 0")
        if self.kind in ("extended_generalized_pi", "generalized_pi") and (self.rising is None or self.falling is None):
            raise ValueError(f"rising, falling: missing; kind {self.kind!r} needs both envelopes")
        if self.kind == "generalized_pi" and self.memoryless.function != "none":
            raise ValueError("memoryless.function: expected 'none' (offset alone) for kind 'generalized_pi'")
        if self.mixing is not None and self.output != FALLING_RESISTANCE:
            raise ValueError(f"mixing: has no meaning for output {self.output!r}; expected {FALLING_RESISTANCE!r}")
        self.model()
        return self

    def model(self) -> FilmModel:
        common: dict[str, Any] = {
            "memoryless": self.memoryless.memoryless(),
            "kind": self.kind,
            "output": self.output,
            "initial": self.initial,
        }
        if self.kind == "mixed_envelopes":
            return FilmModel(
                [o.radius for o in self.operators],  # type: ignore[arg-type]
                [o.weight for o in self.operators],  # type: ignore[arg-type]
                tuple(o.rising.envelope() for o in self.operators),
                tuple(o.falling.envelope() for o in self.operators),
                **common,
            )
        rising = self.rising.envelope() if self.rising else IDENTITY
        falling = self.falling.envelope() if self.falling else IDENTITY
        return FilmModel(self.radii, self.weights, rising, falling, **common)  # type: ignore[arg-type]


class PlateTable(Table):
    """[plate]."""

    kind: Literal["peltier", "heater"] = "peltier"
    seebeck_over_capacity_per_A_s: NotNegative = 0.0
    resistance_over_capacity_K_per_A2_s: NotNegative = 0.0
    conductance_over_capacity_per_s: NotNegative
    drive_over_capacity_K_per_s: NotNegative = 0.0
    ambient_degC: Temperature
    seebeck_slope_per_K: Slope = 0.0
    resistance_slope_per_K: Slope = 0.0
    error_K: NotNegative = 0.0
    error_time_s: NotNegative = 0.0
    inputs: dict[Literal["input_2", "sink_degC", "ambient_degC"], Number] = {}

    @model_validator(mode="after")
    def _check(self) -> PlateTable:
        self.model()
        return self

    def model(self) -> PlateModel:
        names = [name for name in type(self).model_fields if name != "inputs"]  # those of PlateModel
        return PlateModel(**{name: getattr(self, name) for name in names}, inputs=tuple(self.inputs.items()))


class ModelTable(Table):
    """A whole model file; each of [[effects]] has a name of the catalogue and all its parameters."""

    drive: Drive | None = None
    film_records: list[str] = []
    film_seen_degC: tuple[Temperature, Temperature] | None = None
    film: FilmTable | None = None
    plate: PlateTable | None = None
    effects: list[dict[str, float | str]] = []


@dataclass(frozen=True)
class Model:
    """A model file's content: a film, a plate, or both, and effects beyond the base model.

    Attributes
    ----------
    drive : what the film's temperature is predicted from, if the file says so
    mixing : how the film's phases add up; None: as logarithms
    film_records : whole paths of the records that the film was fitted to
    film_seen_degC : the least and the largest temperature in them
    """

    film: FilmModel | None
    plate: PlateModel | None
    effects: tuple[dict[str, float | str], ...] = ()
    drive: Drive | None = None
    mixing: PhaseMixing | None = None
    film_records: tuple[str, ...] = ()
    film_seen_degC: tuple[float, float] | None = None

    def switched(self) -> tuple[Switched, ...]:
        """Return the mixing of the film's phases and the effects with their values. Raises Faults if one is not in the
        catalogue."""
        mixing = () if self.mixing is None else (self.mixing.reading(),)
        if not self.effects:
            return mixing
        from rig.config.effect_tables import switch_effects

        found, lines = switch_effects(self.effects, "effects")
        if lines:
            raise Faults(lines)
        return (*mixing, *found)


def read_model(path: Path, *, needs: tuple[Literal["film", "plate"], ...] = ()) -> Model:
    """Return a checked model; needs: tables that must be there. Raises Faults."""
    table = validate(ModelTable, read_toml(path), path)
    lines = [f"{path}: {name}: missing; expected a table [{name}]" for name in needs if getattr(table, name) is None]
    if table.effects:
        from rig.config.effect_tables import switch_effects

        lines += switch_effects(table.effects, f"{path}: effects")[1]
    if lines:
        raise Faults(lines)
    return Model(
        table.film.model() if table.film else None,
        table.plate.model() if table.plate else None,
        tuple(table.effects),
        table.drive,
        table.film.mixing.mixing() if table.film and table.film.mixing else None,
        tuple(table.film_records),
        table.film_seen_degC,
    )


def write_model(path: Path, model: Model, comment: str = "") -> None:
    """Write a model file; numbers read back to the same bits. comment: lines for its top."""
    table: dict[str, Any] = {} if model.drive is None else {"drive": model.drive}
    if model.film is not None:
        if model.film_records:
            table["film_records"] = list(model.film_records)
        if model.film_seen_degC is not None:
            table["film_seen_degC"] = [float(end) for end in model.film_seen_degC]
        table["film"] = _film_table(model.film)
        if model.mixing is not None:
            names = ("exponent", "percolation", "low_dec", "high_dec")
            table["film"]["mixing"] = {name: float(getattr(model.mixing, name)) for name in names}
    if model.plate is not None:
        table["plate"] = plate_table(model.plate)
    if model.effects:
        table["effects"] = [dict(effect) for effect in model.effects]
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    write_text(path, head + tomli_w.dumps(table, multiline_strings=False))


def _envelope_table(envelope: Envelope) -> dict[str, Any]:
    return {"function": envelope.function, "a": float(envelope.a), "b": float(envelope.b)}


def _film_table(model: FilmModel) -> dict[str, Any]:
    d = model.memoryless
    memoryless: dict[str, Any] = {"function": d.function}
    if d.function in ("tanh", "sin", "cos", "linear"):
        memoryless |= {"amplitude": float(d.amplitude), "a": float(d.a), "b": float(d.b)}
    elif d.function == "polynomial":
        memoryless["coefficients"] = [float(c) for c in d.coefficients]
    elif d.function == "arrhenius":
        memoryless["amplitude"] = float(d.amplitude)
    memoryless["offset"] = float(d.offset)
    table: dict[str, Any] = {"kind": model.kind, "output": model.output, "initial": model.initial}
    if isinstance(model.rising, tuple):
        assert isinstance(model.falling, tuple)
        table["operators"] = [
            {"radius": float(r), "weight": float(p), "rising": _envelope_table(up), "falling": _envelope_table(down)}
            for r, p, up, down in zip(model.radii, model.weights, model.rising, model.falling, strict=True)
        ]
    else:
        assert isinstance(model.falling, Envelope)
        table["radii"] = [float(r) for r in model.radii]
        table["weights"] = [float(p) for p in model.weights]
        if model.kind != "classical_pi":
            table["rising"], table["falling"] = _envelope_table(model.rising), _envelope_table(model.falling)
    table["memoryless"] = memoryless
    return table


def plate_table(model: PlateModel) -> dict[str, Any]:
    """Return a plate as the table [plate]."""
    names = ["drive_over_capacity_K_per_s"]
    if model.kind == "peltier":
        names = ["seebeck_over_capacity_per_A_s", "resistance_over_capacity_K_per_A2_s"]
    names += ["conductance_over_capacity_per_s", "ambient_degC"]
    written = {name: float(getattr(model, name)) for name in names}
    optional = ("seebeck_slope_per_K", "resistance_slope_per_K", "error_K", "error_time_s")
    written |= {name: value for name in optional if (value := float(getattr(model, name))) != 0.0}
    inputs = {"inputs": {name: float(value) for name, value in model.inputs}} if model.inputs else {}
    return {"kind": model.kind, **written, **inputs}
