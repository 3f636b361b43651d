"""The rows that no fit has seen: of the record itself, held out, or of other records of the same rig."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_model import root_mean_square
from sim.diagnosis.data.record import Mask, Record
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.halves import Halves
from sim.diagnosis.validate.held_out import residuals_on
from sim.diagnosis.validate.left_open import film_left_open
from sim.diagnosis.validate.residuals import residuals, rounded


class Other(NamedTuple):
    """Another record of the same rig. told: its rows to which what belongs to it is fitted, None: all."""

    record: Record
    told: Mask | None


@dataclass(frozen=True, eq=False)
class HeldOutRows:
    """Where the gain is measured. chain: what was fitted; others: other records, one after the other, none: the
    held-out rows of the record itself; halves: theirs; on_lattice: whether the thermometer's readings are rounded by
    more than their noise."""

    chain: Chain
    others: tuple[Other, ...] = ()
    halves: Halves | None = None
    on_lattice: bool = False

    @property
    def parts(self) -> tuple[Mask, Mask]:
        """The rows that no fit has seen, in two parts, each of which a candidate has to tell better."""
        if self.halves is None:
            return self.chain.record.deciding, self.chain.record.judging
        return np.concatenate(self.halves.first), np.concatenate(self.halves.second)

    @property
    def rows(self) -> Mask:
        """The rows that no fit has seen and no name was decided by."""
        return self.chain.record.judging if self.halves is None else np.concatenate(self.halves.judging)

    def residuals(self, names: frozenset[str], chain: Chain | None = None) -> dict[str, Array]:
        """Of the fit with these effects in every row, K and decades, as if no reading were rounded; nan without a
        reading or where it was told; of the channels that were read in rows that judge. chain: another than its
        own."""
        chain = self.chain if chain is None else chain
        if self.others:
            found = [(other.record.rows, residuals_on(chain, names, *other)) for other in self.others]
            channels = dict.fromkeys(channel for _, left in found for channel in left)
            whole = {c: np.concatenate([left.get(c, np.full(rows, np.nan)) for rows, left in found]) for c in channels}
        else:
            whole = residuals(chain, names)
        return {c: left for c, left in whole.items() if np.any(np.isfinite(left[self.rows]))}

    def left(self, names: frozenset[str]) -> dict[str, Array]:
        """The same against what a thermometer shows that rounds, where it does."""
        found = self.residuals(names)
        if self._rounds(found):
            found["temperature_K"] = self._rounded(found["temperature_K"])[0]
        return found

    def noise(self, names: frozenset[str], with_path: bool = False) -> dict[str, float]:
        """Of each channel, K and decades: of a thermometer that rounds, about what it is expected to show. with_path:
        of the film what the plate's path is uncertain by, too."""
        first, facts = self.chain.first, self.chain.facts
        noise = {"temperature_K": first.channel.sigma_K if first is not None else 0.0}
        everywhere = self._everywhere.residuals(names) if self.on_lattice else {}
        if self._rounds(everywhere):
            variance = self._rounded(everywhere["temperature_K"])[1]
            noise["temperature_K"] = float(np.sqrt(np.nanmean(variance[self.rows])))
        if with_path and first is not None and (walk := first.channel.noise.wandering) is not None:
            noise["temperature_K"] = float(np.hypot(noise["temperature_K"], root_mean_square(walk.deviation)))
        if facts is not None:
            output = self._output
            rows = np.flatnonzero(self.rows & np.isfinite(output))
            noise["resistance_dec"] = facts.noise.rms(output[rows])
            if with_path:
                noise["resistance_dec"] = root_mean_square(self.film_noise_dec()[rows])
        return noise

    def film_noise_dec(self) -> Array:
        """Of the film's readings, with what the plate's path is uncertain by, (rows,), nan where nothing is judged."""
        output, facts = self._output, self.chain.facts
        assert facts is not None
        rows = np.flatnonzero(self.rows & np.isfinite(output))
        noise_dec = np.full(output.size, np.nan)
        noise_dec[rows] = facts.noise.marginal(output[rows], None if self.others else rows)
        return noise_dec

    def film_left_open_dec(self, names: frozenset[str]) -> Array:
        """What the fitted rows leave open of the film (`sim.diagnosis.validate.left_open`), (rows,), nan in a record
        without one."""
        parts = []
        for record in self._records:
            other = record if self.others else None
            parts.append(_nothing(record) if record.output is None else film_left_open(self.chain, names, other))
        return np.concatenate(parts)

    def left_everywhere(self, names: frozenset[str]) -> dict[str, Array]:
        """As `left`, what belongs to another record fitted to all of it."""
        return self._everywhere.left(names)

    @property
    def _everywhere(self) -> HeldOutRows:
        return replace(self, others=tuple(other._replace(told=None) for other in self.others))

    @property
    def _output(self) -> Array:
        """The film's readings, (rows,), nan where none was read."""
        return np.concatenate([_output(record) for record in self._records])

    @property
    def _records(self) -> list[Record]:
        return [other.record for other in self.others] or [self.chain.record]

    def _rounds(self, found: dict[str, Array]) -> bool:
        return self.on_lattice and "temperature_K" in found

    def _rounded(self, residual_K: Array) -> tuple[Array, Array]:
        """Residuals against the mean reading, and its variance."""
        assert self.chain.first is not None
        readings = np.concatenate([record.temperature_degC for record in self._records])
        return rounded(readings, residual_K, self.chain.first.channel.sigma_K, self.chain.record.step_K)


def _output(record: Record) -> Array:
    """The film's, nan where none was read."""
    if record.output is None:
        return _nothing(record)
    return np.where(record.output_used, record.output, np.nan)


def _nothing(record: Record) -> Array:
    return np.full(record.rows, np.nan)
