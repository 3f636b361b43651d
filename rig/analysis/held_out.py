"""Records of the rig that are held out: each has to be able to judge what is diagnosed, or it is refused.

The gain is measured by a simulation from the record's own current, or temperature where it has no current, against
readings that move: a record without them would leave nothing judged, after minutes of search.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from compensator.hysteresis.functions import Array
from rig.analysis.telling import FEWEST, informative
from rig.core.faults import Faults
from rig.records.film_output import column_of
from rig.records.record_file import Record
from sim.inference.record.quantity import Quantity
from sim.inference.record.record import read_columns


def require_judging(
    holdout: Sequence[Record],
    diagnosed: Sequence[Record],
    telling: Sequence[Mapping[str, Array]],
    output: str,
    say: Callable[[str], None],
) -> None:
    """telling: of each record that is diagnosed the columns that can be used; output: of the film, as in a model file;
    say: told of a record that judges the film alone. Raises Faults, a line a fault, before anything is fitted."""
    film = any(column_of(output, columns) in columns for columns in telling)
    plate = any("current_A" in columns for columns in telling)
    lines = []
    for other in holdout:
        name = column_of(output, other.columns)
        try:
            lost = _lost(other, output)
        except Faults as faults:
            lines += faults.lines
            continue
        judged_by = f"by which a held-out record judges that of {diagnosed[0].source}"
        if film and name in lost:
            lines.append(f"{other.source}: {name}: {lost[name]}; expected a film that switches, {judged_by}")
        if plate and "current_A" in lost:
            if film and "current_A" not in other.columns:
                say(f"{other.source}: no current_A: it judges the film alone")
            else:
                expected = f"expected a current that drives the plate, {judged_by}"
                lines.append(f"{other.source}: current_A: {lost['current_A']}; {expected}")
    if lines:
        raise Faults(lines)


def _lost(other: Record, output: str) -> dict[str, str]:
    """Of film and drive by name why another record tells nothing of them. Raises Faults where it tells nothing."""
    columns, lost = informative(other, output)
    try:
        rows = read_columns(columns, held_out=False, quantity=Quantity(output))
    except ValueError as error:
        raise Faults(f"{other.source}: {line}" for line in str(error).splitlines()) from None
    name = column_of(output, other.columns)
    if rows.output is None:
        few = f"fewer than {FEWEST} finite readings" if name in columns else "missing"
        lost.setdefault(name, few)
    if rows.current_A is None:
        lost.setdefault("current_A", "missing")
    return lost
