"""A record diagnosed: which of its columns can tell something, which kinds of plate are possible, what is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rig.analysis.film_sense import rising
from rig.analysis.telling import telling_columns
from rig.core.faults import Faults, fault
from rig.files.film_output import FALLING_RESISTANCE
from rig.files.record_file import Record
from sim.diagnosis.diagnose import Diagnosis, diagnose
from sim.diagnosis.extended_model import ExtendedModel, extended_model, with_film


def diagnosed(
    record: Record,
    base: str | None = None,
    output: str = FALLING_RESISTANCE,
    holdout: Record | None = None,
    plate: str | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Diagnosis, ExtendedModel]:
    """The diagnosis of one record, with the film's form found; output: of the film, as in a model file. Raises Faults
    where nothing can be said."""
    output = rising([record], output, say)
    columns, notes = telling_columns(record, output)
    for note in notes:
        say(note)
    try:
        diagnosis = diagnose(
            columns,
            base=base,
            output=output,
            holdout=holdout.columns if holdout is not None else None,
            kinds=_kinds(record, plate),
            say=say,
        )
        extended = extended_model(diagnosis)
    except (np.linalg.LinAlgError, ArithmeticError) as error:  # the first is a ValueError too
        text = f"no fit could be made of this record ({type(error).__name__}: {error})"
        raise fault(record.source, "", f"{text}; expected readings that follow current or temperature") from None
    except ValueError as error:
        raise Faults(f"{record.source}: {line}" for line in str(error).splitlines()) from None
    return with_film(diagnosis, extended), extended


def _kinds(record: Record, plate: str | None) -> tuple[str, ...]:
    """The kinds of plate to try: a drive that never cools may be a heater's."""
    if plate is not None:
        return (plate,)
    if record.drive == "pwm255":  # a switched heater's drive is its power
        return ("heater",)
    if record.drive is not None and record.has("current_A") and not bool((record["current_A"] < 0.0).any()):
        return ("peltier", "heater")
    return ("peltier",)
