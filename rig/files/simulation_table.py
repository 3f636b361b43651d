"""[simulation]: what is true of the simulated rig."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from rig.files.bounded_numbers import Count, NotNegative, Number, Positive
from rig.files.model_file import MemorylessTable, PlateTable
from rig.files.toml_file import Table


class RelayFilmTable(Table):
    """[simulation.film] kind = "preisach": a bell-shaped density of relays, see sim.world.films.preisach."""

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
    """[simulation.film] kind = "model": the film of a model file is the truth."""

    kind: Literal["model"]
    model: str


class HeatSinkTable(Table):
    """[simulation.heat_sink_warmup]: see sim.effects.heat_sink_warmup; without it the far side keeps the ambient."""

    sink_capacity_ratio: Positive
    sink_conductance_ratio_per_s: NotNegative


class DetectorTable(Table):
    """[simulation.detector]: what a voltmeter sees of the film's output, see sim.world.detector."""

    volts_per_unit: Number
    offset_V: Number = 0.0
    noise_V: NotNegative = 0.0


class SimulationTable(Table):
    """[simulation]: what is true of the simulated rig; the controller does not see it.

    effects: tables with a name of the catalogue and its parameters, each by default the middle of the usual sizes;
    effect_files: Python files beside this one with effects of one's own, see docs/own_effect.md.
    meter_current_A: the ohmmeter's, where `simulate` has no instruments (a current_profile without that column).
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
    def _default_kind(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("film"), dict):
            return {**data, "film": {"kind": "preisach", **data["film"]}}
        return data
