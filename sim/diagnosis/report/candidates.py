"""What was found and is not named: sets of effects that predict held-out rows better than those that are named.

Which sets are looked at is decided by the fitted rows. The gain is then measured on rows that no fit has seen; but it
is the best of several, and so is a little better than the same effects will do on a further record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.judge.verdict import UNSEEN, Verdict
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.fitted_better import fitted_better
from sim.diagnosis.validate.gain import Gain, gain

Residuals = Callable[[frozenset[str]], dict[str, Array]]
SHOWN: Final = 3  # the best of them: a page of candidates says nothing
LEAST_GAIN: Final = 0.05  # of the error: below it the named set tells the rows as well
AS_GOOD: Final = 1.02  # times the error: a set that needs fewer effects is shown instead, or a channel is not worse


@dataclass(frozen=True)
class Candidate:
    """names; parameters by effect and name; held-out RMSE by channel, of what is named and of these; the 95 % interval
    of its reduction; why they are not named."""

    names: tuple[str, ...]
    parameters: dict[str, dict[str, float]]
    rmse_named: dict[str, float]
    rmse_holdout: dict[str, float]
    reduction_ci95: dict[str, tuple[float, float]]
    why_not_named: str

    def document(self) -> dict[str, Any]:
        """In `peltier-diagnosis/1`."""
        values = {
            effect: {name: {"value": value, "ci95": None} for name, value in own.items()}
            for effect, own in self.parameters.items()
        }
        return {
            "names": list(self.names),
            "parameters": values,
            "rmse_holdout": self.rmse_holdout,
            "why_not_named": self.why_not_named,
        }


def candidates_of(
    chain: Chain,
    judged: Verdict,
    residuals: Residuals,
    parts: tuple[Mask, Mask],
    judging: Mask,
    noise: dict[str, float],
) -> list[Candidate]:
    """The best of them first, at most three. residuals: of a set's fit in every row, nan without a reading; parts: of
    the rows that no fit has seen, each of which a candidate has to tell better; judging: those on which its gain is
    measured; noise: of each channel."""
    named = residuals(judged.fitted)
    found: list[Candidate] = []
    for names in chain.budget.in_time(fitted_better(chain, judged.fitted, judged.refused), 1.0):
        after = residuals(names)
        seen = [_gains(named, after, rows) for rows in parts]
        if not all(any(g.rmse_after < (1.0 - LEAST_GAIN) * g.rmse_before for g in of.values()) for of in seen):
            continue
        if any(g.rmse_after > AS_GOOD * g.rmse_before for of in seen for g in of.values()):
            continue
        gains = _gains(named, after, judging)
        left = max(g.rmse_after / noise[channel] for channel, g in gains.items())
        found.append(
            Candidate(
                tuple(sorted(names)),
                _parameters(chain, names),
                {channel: g.rmse_before for channel, g in gains.items()},
                {channel: g.rmse_after for channel, g in gains.items()},
                {channel: g.reduction_ci95 for channel, g in gains.items()},
                _why(judged, names, left),
            )
        )
    found.sort(key=_share_left)
    return [c for c in found if not _told_by_fewer(c, found)][:SHOWN]


def _gains(before: dict[str, Array], after: dict[str, Array], rows: Mask) -> dict[str, Gain]:
    """Of the channels that were read in these rows."""
    return {c: gain(before[c], after[c], rows) for c in before if np.any(np.isfinite(before[c][rows]))}


def _parameters(chain: Chain, names: frozenset[str]) -> dict[str, dict[str, float]]:
    """As they were fitted."""
    return {
        e.name: {p.name: float(value) for p, value in zip(e.effect.parameters, e.par, strict=True)}
        for fit in chain.fits(names)
        if fit is not None
        for e in fit.effects
    }


def _why(judged: Verdict, names: frozenset[str], left: float) -> str:
    refused = [f"{name}: {judged.refused[name]}" for name in sorted(names) if name in judged.refused]
    if refused:
        return "; ".join(refused)
    if left > UNSEEN:
        return f"held-out rows are still off by {rough(left)} times the noise: another cause may do as much"
    return "fitted on the way to what is named, and not judged by itself"


def _share_left(candidate: Candidate) -> float:
    """Of the named set's error, in the channel that gains most."""
    # > 0: of a simulated record an error may be 0
    return min(candidate.rmse_holdout[c] / max(candidate.rmse_named[c], 1e-300) for c in candidate.rmse_named)


def _told_by_fewer(candidate: Candidate, found: list[Candidate]) -> bool:
    """Whether some of its effects alone do as well."""
    return any(
        set(other.names) < set(candidate.names)
        and all(np.less_equal(other.rmse_holdout[c], AS_GOOD * value) for c, value in candidate.rmse_holdout.items())
        for other in found
    )
