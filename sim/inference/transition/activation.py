"""The activation energy of the insulating side: the slope of ln R over 1 / (k T), away from the transition.

    R = R_0 exp(E / (k T)),   k Boltzmann's constant

How far the foot of the transition reaches cannot be known beforehand. So the fit begins with all rows up to `NEAR`
widths of the transition from where it is steepest, and gives up rows from there until both halves of what is left tell
the same energy within noise or `ALIKE`; the difference that remains is added to the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.constants import Boltzmann, elementary_charge

from compensator.hysteresis.functions import KELVIN, Array
from sim.inference.quantity import Quantity, told, untold
from sim.inference.transition.branch_shape import DRAWS, BranchShape
from sim.inference.transition.local_fit import draw_noise

BOLTZMANN_eV_PER_K: Final = Boltzmann / elementary_charge
NEAR: Final = 1.25  # widths (FWHM): nearer than this it is the transition, whatever the film
LEAST_K: Final = 8.0  # over less, ln R over 1/T is a straight line for any film
LEAST_ROWS: Final = 10
STEP: Final = 0.9  # of the range, that is kept in each step
ALIKE: Final = 0.03  # of the energy: as much as is told of films' energies at best


@dataclass(frozen=True)
class Activation:
    """The energy (eV) and the temperatures (degC) that it was taken from; nan where there are none."""

    energy_eV: Quantity
    low_degC: float
    high_degC: float


def activation_of(shapes: Sequence[BranchShape], log10_ohm: Sequence[Array], seed: int = 0) -> Activation:
    """From the branches of one record, at least one, with their log10 R, shape (rows,) each."""
    centres = [shape.steepest_degC.value for shape in shapes]
    widths = [shape.width_K.value for shape in shapes]
    known = [(c, w) for c, w in zip(centres, widths, strict=True) if c is not None and w is not None]
    if len(known) < len(shapes):
        return _none("where the transition ends is not known")
    degC = np.concatenate([shape.branch.temperature_degC for shape in shapes])
    log = np.concatenate(list(log10_ohm))
    cold = shapes[0].sign * np.sign(_falls(shapes[0], log10_ohm[0])) < 0.0
    foot = min(c - NEAR * w for c, w in known) if cold else max(c + NEAR * w for c, w in known)
    end = float(np.min(degC)) if cold else float(np.max(degC))
    span = (foot - end) if cold else (end - foot)
    side = "begins" if cold else "ends"
    if span < LEAST_K:
        text = f"the record {side} at {end:.1f} degC and the transition's foot is at {foot:.1f} degC"
        return _none(f"{text}; expected at least {LEAST_K:g} K between them")
    found = _none(f"fewer than {LEAST_ROWS} readings on the insulating side")
    while span >= LEAST_K:
        low, high = (end, end + span) if cold else (end - span, end)
        inside = (degC >= low) & (degC <= high)
        if int(np.sum(inside)) < LEAST_ROWS:
            return found
        energy, draws, apart, apart_draws = _energies(degC[inside], log[inside], seed)
        quantity = told(energy, draws, abs(apart))
        assert quantity.ci95 is not None
        if quantity.ci95[0] <= 0.0:
            quantity = untold(f"the resistance does not fall with temperature between {low:.1f} and {high:.1f} degC")
        found = Activation(quantity, low, high)
        if abs(apart) <= max(float(np.quantile(np.abs(apart_draws), 0.95)), ALIKE * abs(energy)):
            break
        span *= STEP
    return found


def _none(reason: str) -> Activation:
    return Activation(untold(reason), float("nan"), float("nan"))


def _falls(shape: BranchShape, log10_ohm: Array) -> float:
    """1 where log10 R has the sense of the output, -1 where it has the other."""
    return float(np.corrcoef(shape.branch.output, log10_ohm)[0, 1])


def _energies(degC: Array, log10_ohm: Array, seed: int) -> tuple[float, Array, float, Array]:
    """The energy (eV), draws of it, and half the difference of what both halves tell, with its draws about 0."""
    x = np.log10(np.e) / (BOLTZMANN_eV_PER_K * (degC + KELVIN))
    middle = 0.5 * (float(x.min()) + float(x.max()))
    half = 0.5 * float(np.ptp(x))
    u = (x - middle) / half
    line, bent = (np.linalg.pinv(np.vander(u, degree + 1, increasing=True)) for degree in (1, 2))
    leave = np.eye(u.size) - np.vander(u, 3, increasing=True) @ bent

    def left_over(readings: Array) -> Array:
        return np.asarray(readings @ leave.T, dtype=np.float64)

    residual = left_over(log10_ohm[None])[0]
    scale = np.full(u.size, max(float(np.std(residual)), 1e-12))
    noise = draw_noise(residual, scale, left_over, DRAWS, seed)
    energy = float(line[1] @ log10_ohm) / half
    # a bend c u^2 has slopes -c and c in the middles of both halves
    return energy, energy + noise @ line[1] / half, float(bent[2] @ log10_ohm) / half, noise @ bent[2] / half
