"""What the loop asks of a policy: a decision a tick, from readings and from when they were taken."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable


@dataclass(frozen=True)
class Decision:
    """What a policy asks for: a current (A), or a setpoint (degC) for the controller's own PID; and what to record.

    setpoint_degC: the temperature that is wanted, or sent where use_setpoint. reference_degC: the course towards it
    that the plate can follow. target_output, predicted_output: of a meter that reads another quantity than ohms.

    done: the phase ends here; a current that stands beside it is sent. wait: nothing is sent, whatever is on stays on.
    """

    current_A: float = math.nan
    setpoint_degC: float = math.nan
    use_setpoint: bool = False
    reference_degC: float = math.nan
    target_ohm: float = math.nan
    predicted_ohm: float = math.nan
    target_output: float = math.nan
    predicted_output: float = math.nan
    done: bool = False
    wait: bool = False


@dataclass(frozen=True)
class ReadAt:
    """When a tick's readings were taken, s: the thermometer's after the tick, the output's before the thermometer's.

    acts_after_s: when a command acts, after the thermometer's reading; as it was at the last tick. test_current_A: of
    the ohmmeter, while it read; 0 where there is none.
    """

    after_s: float = 0.0
    output_age_s: float = 0.0
    acts_after_s: float = 0.0
    test_current_A: float = 0.0


AT_THE_TICK = ReadAt()


def read_at(
    begin_s: float, tick_s: float, row_s: float, output_s: float, acts_after_s: float, test_current_A: float
) -> ReadAt:
    """Out of a run's times (s): of its phase's beginning, of its row and of the row's output (nan: none).

    tick_s: of the tick, from the beginning of the phase. test_current_A: nan where there is none.
    """
    age_s = 0.0 if math.isnan(output_s) else row_s - output_s
    return ReadAt(row_s - begin_s - tick_s, age_s, acts_after_s, 0.0 if math.isnan(test_current_A) else test_current_A)


class Policy(Protocol):
    """What decides. time_s, of the tick, runs from the start of its phase; output is -log10(R / 1 ohm), nan where
    unknown."""

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision: ...


@runtime_checkable
class Predicts(Protocol):
    """A policy that goes by what its commands do: it has to know when each acts, and which nobody acknowledged."""

    def acted(self, acts_s: float) -> None:
        """When the last decision's command acted, in the phase's time."""

    def held(self, current_A: float) -> None:
        """The last decision's command is not known to have arrived: this current is on, A."""
