"""What a film's output is, where it is not a resistance that falls as temperature rises.

The fit of the last links thinks in decades of a resistance: its priors' widths are decades. Another quantity, in any
unit, is moved and stretched so that the record's range of it is that of a film of a few decades, and what is said of it
is turned back into its unit. The readings' noise and its evidence do not change by that.

A resistance that rises is fitted as its conductance, which falls; what an ohmmeter makes of a resistance r, it makes of
a conductance g as 1 / read(1 / g).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, of_resistances
from sim.model.conductance import of_conductance

FALLING_OHM, RISING_OHM = "minus_log10_ohm", "log10_ohm"
MINUS = "minus_"
SPAN = 3.0  # decades that another quantity's range counts as: of a usual film of vanadium dioxide


@dataclass(frozen=True)
class Quantity:
    """name: of the film's output, as in a model file, rising with temperature. One of the fit's decades is `size` of
    its unit, counted from `centre`."""

    name: str = FALLING_OHM
    centre: float = 0.0
    size: float = 1.0

    @property
    def is_resistance(self) -> bool:
        """Whether it is a resistance on a log scale."""
        return self.name in (FALLING_OHM, RISING_OHM)

    @property
    def rises(self) -> bool:
        """Whether it is a resistance that rises with temperature."""
        return self.name == RISING_OHM

    @property
    def column(self) -> str:
        """The record's column that it is made of."""
        return "resistance_ohm" if self.is_resistance else self.name.removeprefix(MINUS)

    @property
    def unit(self) -> str:
        """Of its errors: decades, or what the name ends in."""
        return "dec" if self.is_resistance else self.column.partition("_")[2] or "1"

    @property
    def channel(self) -> str:
        """Its key in the JSON."""
        return "resistance_dec" if self.is_resistance else self.column

    @property
    def called(self) -> str:
        """For people."""
        return "log R" if self.is_resistance else self.column

    def of(self, columns: Mapping[str, ArrayLike]) -> Array | None:
        """The output in a record's rows, in the fit's decades, nan where there is no reading; None without a column."""
        if self.is_resistance:
            if "resistance_ohm" not in columns:
                return None
            ohm = np.asarray(columns["resistance_ohm"], dtype=np.float64)
            good = np.isfinite(ohm) & (ohm > 0.0)
            output = np.full(ohm.size, np.nan)
            output[good] = np.log10(ohm[good])
            return output if self.rises else -output
        values = _values(self.name, columns)
        return None if values is None else np.where(np.isfinite(values), (values - self.centre) / self.size, np.nan)

    def values(self, output: Array) -> Array:
        """What is read, for the fit's output: ohm, or the column's own values."""
        if self.is_resistance:
            return self.ohm(output)
        own = self.centre + self.size * output
        return np.asarray(-own if self.name.startswith(MINUS) else own, dtype=np.float64)

    def ohm(self, output: Array) -> Array:
        """The resistance for the fit's output."""
        return np.asarray(10.0**output if self.rises else 10.0**-output, dtype=np.float64)

    def effects(self, known: Mapping[str, Effect]) -> dict[str, Effect]:
        """Those that it can have, as they are on the fit's output."""
        if self.name == FALLING_OHM:
            return dict(known)
        if self.rises:
            return {name: of_conductance(effect) for name, effect in known.items()}
        return {name: effect for name, effect in known.items() if not of_resistances(effect)}

    def film(self, model: FilmModel) -> FilmModel:
        """The fit's model in the output's own unit."""
        d = model.memoryless
        stretched = replace(
            d,
            amplitude=self.size * d.amplitude,
            offset=self.centre + self.size * d.offset,
            coefficients=tuple(self.size * c for c in d.coefficients),
        )
        return replace(model, weights=self.size * model.weights, memoryless=stretched, output=self.name)


RESISTANCE = Quantity()


def quantity_of(name: str, columns: Mapping[str, ArrayLike]) -> Quantity:
    """A film's output by its name, with the range that a record has of it."""
    found = Quantity(name)
    values = None if found.is_resistance else _values(name, columns)
    if values is None or not np.any(np.isfinite(values)):
        return found
    low, high = (float(v) for v in np.nanpercentile(values[np.isfinite(values)], [1.0, 99.0]))
    return Quantity(name, 0.5 * (low + high), (high - low) / SPAN) if high > low else found


def _values(name: str, columns: Mapping[str, ArrayLike]) -> Array | None:
    """A column, or the negative of one."""
    if name in columns:
        return np.asarray(columns[name], dtype=np.float64)
    other = name.removeprefix(MINUS)
    return -np.asarray(columns[other], dtype=np.float64) if name != other and other in columns else None
