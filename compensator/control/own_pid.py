"""Gains for the PID that a temperature controller has of its own, from the plate model.

    I = Kp (e + 1/Ti integral of e dt - Td dT/dt)        e = setpoint - T, sampled every tick

The plate at a temperature and current is b / (s + p). SIMC (S. Skogestad, J. Process Control 13 (2003) 291) for the
plate where it answers most, the closed-loop time lengthened until the sampled loop keeps Ms, and until the
thermometer's noise moves the current by no more than a share of its limit.
"""

from __future__ import annotations

from dataclasses import dataclass

from compensator.control.design import Design, design_pi


@dataclass(frozen=True)
class OwnPid:
    """Kp in A/K, Ti and Td in s (0: no such part), sampled every tick_s; damping: pole of the filter on dT/dt."""

    kp_A_per_K: float
    ti_s: float
    td_s: float = 0.0
    damping: float = 0.3
    tick_s: float = 0.1


NOISE_SHARE = 0.05  # of the current limit, by which noise of one standard deviation may move the current


def design_own_pid(
    gain_K_per_A_s: float,
    pole_per_s: float,
    tick_s: float,
    dead_time_s: float,
    ms: float,
    noise_K: float,
    current_limit_A: float,
) -> tuple[OwnPid, Design]:
    """The fastest PI within Ms and the noise, without a derivative: a plate is of the first order."""
    design = design_pi(gain_K_per_A_s, pole_per_s, dead_time_s, tick_s, ms)
    most = NOISE_SHARE * current_limit_A / noise_K if noise_K > 0.0 else design.gains.kp
    if design.gains.kp > most:
        slower = 1.0 / (gain_K_per_A_s * most)  # closed-loop time and delays together
        design = design_pi(gain_K_per_A_s, pole_per_s, dead_time_s, tick_s, ms, at_least_s=slower)
    gains = design.gains
    return OwnPid(gains.kp, gains.kp / gains.ki, 0.0, tick_s=tick_s), design
