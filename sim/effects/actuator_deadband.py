"""actuator_deadband (driver): no output while |I| < deadband_A.

    I_plate = 0 where |I| < deadband_A, else I

Met: 0.02 .. 0.3 A (an H bridge's shortest pulse, a driver's zero). Source: K. J. Astrom, T. Hagglund, Advanced PID
Control (ISA 2006), ch. 10, on actuators with a dead zone.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Command, Effect, Parameter


def send(par: Array, time_s: Array, current_A: Array) -> tuple[Array, Array]:
    """Small currents become none."""
    return time_s, np.where(np.abs(current_A) < par[0], 0.0, current_A)


EFFECT = Effect(
    "actuator_deadband",
    "driver",
    (Parameter("deadband_A", 0.02, 0.3),),
    Command(send, jumps=np.abs),
    "small currents do not reach the plate",
    "measure the current at the element; bias the plate so that the current does not cross zero",
)
