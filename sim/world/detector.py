"""A detector between the film and a voltmeter: a position-sensitive diode that watches a cantilever bend.

    voltage_V = offset_V + volts_per_unit * u        u: the film's output, in its own unit (1/m of a curvature)

Linear: what a real one adds at the ends of its range is not simulated.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Detector:
    """volts_per_unit: of the film's output. noise_V: standard deviation of a reading."""

    volts_per_unit: float
    offset_V: float = 0.0
    noise_V: float = 0.0

    def voltage_V(self, output: float, standard_normal: float = 0.0) -> float:
        """What the voltmeter sees, V."""
        return self.offset_V + self.volts_per_unit * output + self.noise_V * standard_normal
