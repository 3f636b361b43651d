"""A record diagnosed: which effects it is likely to have, and what they leave over."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from threadpoolctl import threadpool_limits

from compensator.thermal.plate import Kind
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from sim.findings.intervals import covariance
from sim.findings.result import Diagnosis, result
from sim.findings.search import Search
from sim.findings.starts import base_fit
from sim.inference.joint import Fit, TwoChannels
from sim.model.recorded import Mask

SURE: Final = 4.0  # standard deviations from nothing: a drive that moves a plate is hundreds of them away
STILL: Final = "current_A: this drive does not move this temperature; no effect on driver or plate can be named"


def drive_moves(fit: Fit) -> bool:
    """Return False if all coefficients of the drive are as good as 0: it does not move the plate."""
    errors = covariance(fit).standard_errors
    names = [name for name in ("s", "r", "q") if name in fit.joint.place]
    return any(fit.at.x[fit.joint.place[name]] > SURE * errors[fit.joint.place[name]] for name in names)


@dataclass(frozen=True, eq=False)
class Selected:
    """The likeliest set: base and extended fit, and the search with all sets that were fitted."""

    base: Fit
    fit: Fit
    search: Search
    warnings: tuple[str, ...] = ()

    def value(self) -> float:
        """Log-likelihood less the price of the effects, and of the parameters that this kind of plate has."""
        joint = self.fit.joint
        return self.search.value(self.fit) - 0.5 * len(joint.unknowns) * math.log(joint.rows_K.size)


def selected(
    record: TwoChannels,
    effects: Sequence[Effect] | None = None,
    kinds: Sequence[Kind] = ("peltier",),
    say: Callable[[str], None] = lambda text: None,
) -> Selected:
    """Select the effects of a record. effects: those that are possible; None: the catalogue. kinds: of plate that are
    possible; the likelier one is taken. Raises ValueError for a
    record of a temperature alone."""
    if record.current_A is None and record.output is None:
        raise ValueError("record: neither current_A nor a film's output; expected at least one of them")
    found = [_of_kind(record, effects, kind, say) for kind in (kinds if record.current_A is not None else kinds[:1])]
    return max(found, key=Selected.value)


def _of_kind(record: TwoChannels, effects: Sequence[Effect] | None, kind: Kind, say: Callable[[str], None]) -> Selected:
    """The selection with one kind of plate."""
    with threadpool_limits(limits=1):
        known = list(catalogue().values()) if effects is None else effects
        base = base_fit(record, kind)
        warnings: tuple[str, ...] = ()
        if base.joint.driven and not drive_moves(base):
            known = [effect for effect in known if effect.link not in ("driver", "plate")]
            warnings = (STILL,)
        search = Search(known, say)
        return Selected(base, search.run(base), search, warnings)


def diagnosed(
    record: TwoChannels,
    held: Mask,
    effects: Sequence[Effect] | None = None,
    kinds: Sequence[Kind] = ("peltier",),
    say: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Diagnose a record. held: rows in which errors are reported, from fits that have not seen them."""
    found = selected(record, effects, kinds, say)
    with threadpool_limits(limits=1):
        return result(found.base, found.fit, found.search, held, found.warnings, say)
