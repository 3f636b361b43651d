"""A film whose resistance rises as it is heated: the world's -log10(R / 1 ohm) of a model of log10(R / 1 ohm)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from compensator.hysteresis.film import FilmModel, Memoryless


@dataclass(frozen=True, eq=False)
class RisingFilm:
    """The film of a model whose output is "log10_ohm", as `sim.model.film_side.Film` asks for it."""

    model: FilmModel

    @property
    def memoryless(self) -> Memoryless:
        """Its D(T) in -log10(R / 1 ohm)."""
        d = self.model.memoryless
        coefficients = tuple(-c for c in d.coefficients)
        return replace(d, amplitude=-d.amplitude, offset=-d.offset, coefficients=coefficients)

    def simulate(self, inputs_degC: Any, memory: Any) -> tuple[Any, Any]:
        """-log10 R over temperatures, and the memory after the last."""
        outputs, after = self.model.simulate(inputs_degC, memory)
        return -outputs, after

    def step(self, input_degC: float, memory: Any) -> tuple[float, Any]:
        """The same for one temperature."""
        output, after = self.model.step(input_degC, memory)
        return -output, after

    def initial_memory(self, input_degC: float, initial: Any = None) -> Any:
        """The model's own memory."""
        return self.model.initial_memory(input_degC, initial)


def film_of_world(model: FilmModel) -> FilmModel | RisingFilm:
    """The film whose output a simulated meter reads: -log10 of a resistance, or any other quantity as it is."""
    return RisingFilm(model) if model.output == "log10_ohm" else model
