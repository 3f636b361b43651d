"""From a record to a diagnosis: what the simulation gets wrong, why, and what the extended model gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from compensator.thermal.plate import Kind
from sim.diagnosis.judge import judged
from sim.diagnosis.result import Caution, Diagnosis
from sim.diagnosis.search import Search
from sim.diagnosis.selection import selected
from sim.diagnosis.sparse_loop import sparse_loop
from sim.diagnosis.warnings import out_of_time
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect, Reading, pinned
from sim.inference.evidence import FALSE_ALARM, FALSE_ALARMS
from sim.inference.record.joined import read_records
from sim.inference.record.quantity import FALLING_OHM
from sim.inference.record.record import Record

SEARCHING: Final = 0.7  # of a budget: gains, candidates and limits take about a third of a search's time
STILL: Final = "this drive does not move this temperature; no effect on driver or plate can be named"


def stopped() -> float:
    """Return the time of a clock that stands still: of whoever has time."""
    return 0.0


def diagnose(
    columns: Mapping[str, ArrayLike],
    *further: Mapping[str, ArrayLike],
    base: str | None = None,
    output: str = FALLING_OHM,
    effects: Mapping[str, Effect] | None = None,
    kinds: Sequence[Kind] = ("peltier",),
    assume: Mapping[str, Mapping[str, float]] | None = None,
    false_alarm: float = FALSE_ALARM,
    budget_s: float | None = None,
    clock: Callable[[], float] = stopped,
    say: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Diagnose one record (columns as in a record file, names with units), or several of one rig as one.

    base: "generalized_pi": the film has no D(T), unless the record needs one, which is then named `memoryless_term`.
    output: of the film, rising with temperature, as in a model file. effects: those that are possible; None: the
    catalogue. kinds: of plate that are possible; the likelier one is taken. assume: effects that are there, with the
    parameters that are known. false_alarm: the share of records without any effect that may be given a name. budget_s:
    seconds on the clock, after which the best so far is reported. Raises ValueError, a line a fault.
    """
    if budget_s is not None and clock is stopped:
        raise ValueError("budget_s: needs a clock; expected clock=time.monotonic with it")
    if not FALSE_ALARMS[0] <= false_alarm <= FALSE_ALARMS[1]:
        raise ValueError(f"false_alarm: {false_alarm:g}: expected {FALSE_ALARMS[0]:g} to {FALSE_ALARMS[1]:g}")
    ends_s = np.inf if budget_s is None else clock() + budget_s
    search_ends_s = np.inf if budget_s is None else clock() + SEARCHING * budget_s
    record = read_records((columns, *further), output, held_out=True)
    known = record.quantity.effects(catalogue() if effects is None else effects)
    record = record.read_while_it_ran(known.values()).commanded_in_sight(known.values())
    if record.current_A is None and record.output is None:
        raise ValueError(f"record: neither current_A nor {record.quantity.column}; expected at least one of them")
    assumed = _assumed(known, assume or {}, record)
    names, sparse = frozenset(effect.name for effect in assumed), sparse_loop(record)
    possible = [effect for effect in known.values() if sparse is None or effect.before_film]
    warnings: list[Caution] = []
    with threadpool_limits(limits=1):
        plate = " or ".join("Peltier plate" if kind == "peltier" else "heater" for kind in kinds)
        driven = record.current_A is not None
        say(f"fitting the base model of a {plate}" if driven else "fitting the base film model")
        search = Search(possible, say, names, false_alarm, lambda: clock() > search_ends_s)
        chosen = selected(record, kinds, assumed, search)
        if clock() > search_ends_s and budget_s is not None:
            warnings.append(out_of_time(budget_s))
        if not chosen.drive_moves:
            warnings.append(Caution("drive_without_effect", f"current_A: {STILL}"))
        if base == "generalized_pi":
            chosen = chosen.without_memoryless(record, sparse is None)
        return judged(record, chosen, known, sparse, warnings, lambda: clock() > ends_s, say)


def _assumed(known: Mapping[str, Effect], assume: Mapping[str, Mapping[str, float]], record: Record) -> list[Effect]:
    """Return the assumed effects, with the parameters that are known. Raises ValueError for one that the record cannot
    have."""
    lines = []
    for name in assume:
        effect = known.get(name)
        if effect is None:
            lines.append(f"{name}: no effect of this record's film; expected one of {', '.join(known)}")
        elif effect.before_film and record.current_A is None:
            lines.append(f"{name}: current_A: missing; an effect on the {effect.link} needs it")
        elif not effect.before_film and record.output is None:
            lines.append(f"{name}: {record.quantity.column}: missing; an effect on the {effect.link} needs it")
        elif getattr(effect.form, "heated", False) and record.test_current_A is None:
            lines.append(f"{name}: meter_current_A: missing; the heat of the test current needs it")
        elif isinstance(effect.form, Reading) and effect.form.rounding:
            lines.append(f"{name}: is seen in the readings, and needs no assumption")
    if lines:
        raise ValueError("\n".join(lines))
    return [pinned(known[name], values) for name, values in assume.items()]
