"""A record diagnosed: which effects it is likely to have, and what they leave over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from threadpoolctl import threadpool_limits

from compensator.thermal.plate import Kind
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from sim.findings.result import Diagnosis, result
from sim.findings.search import Search
from sim.findings.starts import base_fit
from sim.inference.joint import Fit, TwoChannels
from sim.model.recorded import Mask


@dataclass(frozen=True, eq=False)
class Selected:
    """The likeliest set: base and extended fit, and the search with all sets that were fitted."""

    base: Fit
    fit: Fit
    search: Search


def selected(
    record: TwoChannels,
    effects: Sequence[Effect] | None = None,
    kind: Kind = "peltier",
    say: Callable[[str], None] = lambda text: None,
) -> Selected:
    """Select the effects of a record. effects: those that are possible; None: the catalogue."""
    with threadpool_limits(limits=1):
        search = Search(list(catalogue().values()) if effects is None else effects, say)
        base = base_fit(record, kind)
        return Selected(base, search.run(base), search)


def diagnosed(
    record: TwoChannels,
    held: Mask,
    effects: Sequence[Effect] | None = None,
    kind: Kind = "peltier",
    say: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Diagnose a record. held: rows in which errors are reported, from fits that have not seen them."""
    found = selected(record, effects, kind, say)
    with threadpool_limits(limits=1):
        return result(found.base, found.fit, found.search, held, say)
