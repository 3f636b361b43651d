"""What passes through the loop each tick: the readings' times, a policy's decision, and the tick as it was."""

from __future__ import annotations

import base64
import inspect
import math
import pickle
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from rig.core.faults import fault
from rig.core.reading import Reading

if TYPE_CHECKING:
    from rig.safety.bench_watch import BenchWatch


@dataclass(frozen=True)
class Decision:
    """Decision of a policy: a current (A), or a setpoint (degC) for the controller's own PID; and what to record.

    setpoint_degC: the wanted temperature; it is sent if use_setpoint. reference_degC: the course towards it that the
    plate can follow. target_output, predicted_output: of a meter that reads another quantity than ohms. done: the phase
    ends here; a current given with it is sent. wait: nothing is sent, the output stays as it is.
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
    """Times of a tick's readings, s: the thermometer's after the tick, the output's before the thermometer's.

    acts_after_s: from the thermometer's reading until a command acts, as it was at the last tick. test_current_A: of
    the ohmmeter, while it read; 0 if there is none.
    """

    after_s: float = 0.0
    output_age_s: float = 0.0
    acts_after_s: float = 0.0
    test_current_A: float = 0.0


AT_THE_TICK = ReadAt()


def read_at(
    begin_s: float, tick_s: float, row_s: float, output_s: float, acts_after_s: float, test_current_A: float
) -> ReadAt:
    """Return the reading times from a run's times (s): of its phase's beginning, its row and the row's output (nan:
    none).

    tick_s: of the tick, from the beginning of the phase. test_current_A: nan if there is none.
    """
    age_s = 0.0 if math.isnan(output_s) else row_s - output_s
    return ReadAt(row_s - begin_s - tick_s, age_s, acts_after_s, 0.0 if math.isnan(test_current_A) else test_current_A)


class Policy(Protocol):
    """Policy of a phase. time_s, of the tick, runs from the start of the phase; output is -log10(R / 1 ohm), nan if
    unknown."""

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision: ...


@runtime_checkable
class Predicts(Protocol):
    """Policy that predicts from its commands: it needs to know when each acts, and which were not acknowledged."""

    def acted(self, acts_s: float) -> None:
        """Take the time at which the last decision's command acted, in the phase's time."""

    def held(self, current_A: float) -> None:
        """Take the current (A) that is on, as the last decision's command may not have arrived."""


@dataclass
class Ticks:
    """Punctuality of the loop: ticks done, ticks missed, largest lateness (s).

    gaps: times without a reading for more than `rig.control.loop.GAP_S` with a current on; unwatched_s: the longest
    time without a reading with a current on. unacknowledged: ticks whose command the controller did not acknowledge.
    """

    done: int = 0
    missed: int = 0
    latest_s: float = 0.0
    gaps: int = 0
    unwatched_s: float = 0.0
    unacknowledged: int = 0


@dataclass(frozen=True)
class Tick:
    """One tick: time of the run (s), readings with quality, the test current at the ohmmeter's reading, the command
    (nan: nothing sent), the watch."""

    time_s: float
    phase: str
    temperature: Reading
    resistance: Reading | None
    test_current_A: float
    current_A: float
    decision: Decision
    watch: BenchWatch


Phases = list[tuple[str, float]]  # each with the seconds that it is expected to take


class Onlooker:
    """Whoever shows how far an experiment is, over all its runs; this one does nothing."""

    def expect(self, phases: Phases, drive_unit: str, quantity: str) -> None:
        """Take the phases to come. drive_unit: "A", or a heater's; quantity: column of the meter, "" if there is
        none."""

    def began(self) -> None:
        """Take that a loop has the bench from now on."""

    def phase(self, name: str, done_s: float, of_s: float) -> None:
        """Take how far a phase is; once, at its begin, with 0 s done."""

    def tick(self, tick: Tick) -> None:
        """Take a tick, whose row is written."""

    def ended(self, off_confirmed: bool, ticks: Ticks) -> None:
        """Take that the loop is over and the output commanded off."""


# ---- a user-defined law in a run folder: its source, and its state as each phase begins ----
#
# The file is the module that the law's class was imported from. A class of the script itself, or of a notebook's cell,
# is not kept: to import such a script again would run the experiment again.

EXPECTED = "expected its class in a file of its own, which the script or notebook imports"


@dataclass(frozen=True)
class KeptLaw:
    """User-defined law in a run folder.

    file, text: the law's module. entries: of the event that begins its phase: how to make the law again, or why that is
    impossible.
    """

    file: str = ""
    text: str = ""
    entries: dict[str, str] = field(default_factory=dict)


def kept_law(policy: Policy) -> KeptLaw:
    """Return what a run folder keeps of a law to replay it; nothing for a law of this program."""
    kind = type(policy)
    if kind.__module__.partition(".")[0] == "rig":
        return KeptLaw()
    try:
        path = Path(inspect.getfile(kind))
        text = path.read_text(encoding="utf-8")
    except (TypeError, OSError, ValueError):
        return KeptLaw(entries={"not_kept": f"it stands in no file; {EXPECTED}"})
    if kind.__module__ == "__main__":
        return KeptLaw(entries={"not_kept": f"it stands in the script that ran; {EXPECTED}"})
    try:
        state = base64.b64encode(pickle.dumps(vars(policy))).decode()
    except Exception as error:  # whatever an attribute does when it is pickled
        return KeptLaw(entries={"not_kept": f"an attribute of it cannot be pickled ({error})"})
    return KeptLaw(path.name, text, {"law": f"{path.name}:{kind.__qualname__}", "state": state})


def law_of(folder: Path, phase: dict[str, Any]) -> Policy:
    """Return the law of a phase as it was when the phase began. phase: its event. Raises Faults."""
    file, _, name = str(phase["law"]).rpartition(":")
    path = folder / Path(file).name
    if not path.is_file():
        raise fault(path, "", "no such file; expected the law that ran")
    module = ModuleType(f"law_of_a_run_{path.stem}")
    sys.modules[module.__name__] = module  # where dataclasses look themselves up
    sys.path.insert(0, str(folder.absolute()))  # what it imports may have been put beside it
    try:
        exec(compile(path.read_bytes(), path, "exec"), vars(module))  # no __pycache__ in a run folder
        kind: Any = module
        for part in name.split("."):
            kind = getattr(kind, part)
        law = kind.__new__(kind)
        vars(law).update(pickle.loads(base64.b64decode(str(phase["state"]))))
    except Exception as error:  # whatever a user's file does when it is imported
        text = f"{name} cannot be made again: {type(error).__name__}: {error}"
        raise fault(path, "", f"{text}; expected the file as it ran, with what it imports beside it") from None
    finally:
        sys.path.remove(str(folder.absolute()))
    return law  # type: ignore[no-any-return]
