"""What is true of a simulated rig, and the noise of its instruments."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from compensator.thermal.plate import PlateModel
from sim.effects.effect import Switched
from sim.model.chain import ChainModel
from sim.model.film_side import Film


@dataclass(frozen=True)
class Detector:
    """A detector between the film and a voltmeter: a position-sensitive diode that watches a cantilever bend. Linear:
    what a real one adds at the ends of its range is not simulated.

        voltage_V = offset_V + volts_per_unit * u        u: the film's output, in its own unit (1/m of a curvature)

    noise_V: standard deviation of a reading.
    """

    volts_per_unit: float
    offset_V: float = 0.0
    noise_V: float = 0.0

    def voltage_V(self, output: float, standard_normal: float = 0.0) -> float:
        """Return what the voltmeter reads, V."""
        return self.offset_V + self.volts_per_unit * output + self.noise_V * standard_normal


@dataclass(frozen=True)
class World:
    """What is true of the simulated rig.

    effects: what is switched on. current_limit_A: of the driver. detector: where a voltmeter reads the film.
    thermometer_noise_K, ohmmeter_noise_dec: standard deviation of a reading.
    """

    plate: PlateModel
    film: Film
    first_degC: float = 25.0
    film_initial: str = "cooled"
    thermometer_noise_K: float = 0.005
    ohmmeter_noise_dec: float = 0.001
    current_limit_A: float = 16.0
    seed: int = 0
    effects: tuple[Switched, ...] = ()
    detector: Detector | None = None

    def __post_init__(self) -> None:
        for name in ("thermometer_noise_K", "ohmmeter_noise_dec"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name}: {value}: expected a finite number >= 0")

    @property
    def model(self) -> ChainModel:
        """Plate, film and effects."""
        return ChainModel(self.plate, self.film, self.effects)


@dataclass
class Noise:
    """Standard normal numbers, drawn in blocks."""

    random: np.random.Generator
    block: list[float] = field(default_factory=list)

    def draw(self) -> float:
        if not self.block:
            self.block = self.random.standard_normal(4096).tolist()
        return self.block.pop()


def noises(seed: int) -> tuple[Noise, Noise]:
    """Of the thermometer and of the ohmmeter, independent."""
    thermometer, ohmmeter = np.random.default_rng(seed).spawn(2)
    return Noise(thermometer), Noise(ohmmeter)
