"""radiative_loss (plate): an extra loss eps (T_p^4 - T_a^4), temperatures in kelvin.

loss_per_K3_s = eps/C with eps = emissivity x area x 5.67e-8 W/m^2/K^4. Met: eps 2e-11 (a bare plate of 4 cm^2) ..
5e-10 W/K^4 (a holder of 90 cm^2), with C of 3 .. 60 J/K. Source: the Stefan-Boltzmann law; F. P. Incropera et al.,
Fundamentals of Heat and Mass Transfer (Wiley 2007), ch. 12.
"""

from __future__ import annotations

from sim.effects.effect import Effect, HeatFlow, Parameter
from sim.effects.heat_term import heat_term


@heat_term
def plate_rate(
    eps: float, unused: float, s: float, r: float, g: float, ambient: float, time: float, plate: float, own: float,
    current: float,
) -> float:  # fmt: skip
    """Return what the surface radiates, less what it receives."""
    hot, cold = plate + 273.15, ambient + 273.15
    return -eps * (hot * hot * hot * hot - cold * cold * cold * cold)


EFFECT = Effect(
    "radiative_loss",
    "plate",
    (Parameter("loss_per_K3_s", 3e-13, 1.7e-10),),
    HeatFlow(plate_rate),
    "the plate loses heat by radiation, which grows faster than the temperature",
    "shield the plate, or polish its holder",
)
