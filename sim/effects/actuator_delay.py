"""actuator_delay (driver): the current acts delay_s after it was commanded.

    I_plate(t) = I(t - delay_s)

Met: 0.2 .. 5 s (a fieldbus, a controller's own cycle). Delays below about 0.2 sample intervals are one class.
Source: K. J. Astrom, T. Hagglund, Advanced PID Control (ISA 2006), ch. 2, dead time.
"""

from __future__ import annotations

from compensator.hysteresis.functions import Array
from sim.effects.effect import Command, Effect, Parameter


def send(par: Array, time_s: Array, current_A: Array) -> tuple[Array, Array]:
    """Return the same currents, later."""
    return time_s + par[0], current_A


EFFECT = Effect(
    "actuator_delay",
    "driver",
    (Parameter("delay_s", 0.2, 5.0),),
    Command(send),
    "the current acts later than it was commanded",
    "log the controller's own output current; look for a slow bus or a long control cycle",
    order=1,
)
