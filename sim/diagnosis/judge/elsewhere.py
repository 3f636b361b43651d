"""Names that other records of the same rig speak against are not said.

A film of another kind may bend its own output, which another record shows. And where a fit leaves what no model
explains, an effect may do there what another cause does: then the error of a prediction grows with it elsewhere, of the
plate's temperature beyond what its first rows leave open, of a film's output, of which they leave little open, at all.
A record that is understood needs no such question: there the evidence is certain, and what its first rows leave open of
another's room is more than some effects change.

Rows that decide do not judge. The other records are two halves (`sim.diagnosis.validate.halves`), and each is asked by
itself. A name is said where neither half speaks against it. Of several records each half has records of its own, and a
cause may show in one of them alone: a name that one half speaks against is then asked of all of them together, whose
error must not grow with it. A half judges where the other one alone comes to just these names: so both do where they
agree, each of what the other one decided, and else the one whose answer changed nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.misfit import correlated_rows
from sim.diagnosis.data.record import Mask, Record
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.judge.output_nonlinearity import is_output_nonlinearity
from sim.diagnosis.judge.verdict import UNSEEN, Verdict, is_prandtl_ishlinskii, judge
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.adequacies import resistance_residual, temperature_residual
from sim.diagnosis.validate.halves import Halves, halves_of
from sim.diagnosis.validate.held_out import residuals_on
from sim.inference.nuisance import told_rows

GROWS: Final = 1.05  # times the error from which it grows: what a candidate that is told has to gain
BENDS: Final = "on another record the film is not understood, and may bend its output itself"
UNITS: Final = {"temperature_K": "K", "resistance_dec": "decades"}
Errors = Callable[[frozenset[str]], dict[str, Array]]


@dataclass(frozen=True, eq=False)
class BorneOut:
    """judged: less the names that other records speak against; halves: of these records' rows, and which of them
    judge; None without other records."""

    judged: Verdict
    halves: Halves | None = None


def borne_out(chain: Chain, judged: Verdict, others: Sequence[Record]) -> BorneOut:
    """What others of the same rig leave of a verdict."""
    if not others:
        return BorneOut(judged)
    halves = halves_of(others, [_correlated_s(chain, judged.fitted, other) for other in others])
    asked = _asked(chain, judged, others) if judged.names else {}
    if not asked and not _may_bend(chain, judged.fitted):
        return BorneOut(judged, halves)
    errors = _predictions(chain, others)
    found = [_less(chain, judged, others, half, errors, asked) for half in (halves.first, halves.second)]
    said, refused = found[0].fitted & found[1].fitted, found[0].fitted ^ found[1].fitted
    needed = frozenset[str]()
    if len(others) > 1 and refused:
        every = tuple(a | b for a, b in zip(halves.first, halves.second, strict=True))
        needed = _less(chain, judged, others, every, errors, asked).fitted & refused
    said |= needed
    alone = [one.fitted == said for one in found]
    if any(alone):
        judging = halves.judged_by(alone[1], alone[0], refused, needed)
        return BorneOut(found[alone.index(True)], judging)
    why = "each half of the other records speaks against another name"
    return BorneOut(judge(chain, said, judged, why), halves.judged_by(False, False, refused, needed))


def _may_bend(chain: Chain, names: frozenset[str]) -> frozenset[str]:
    """The effects that bend the reading of a film of another kind, which may bend it itself."""
    if chain.facts is None or is_prandtl_ishlinskii(chain, names):
        return frozenset()
    return frozenset(n for n in names - chain.assumed if is_output_nonlinearity(chain.effects[n]))


def _bends_elsewhere(chain: Chain, names: frozenset[str], other: Record, rows: Mask) -> frozenset[str]:
    """Those of them where these rows of another record show that the film is not understood."""
    bends = _may_bend(chain, names)
    if not bends or chain.facts is None or other.output is None:
        return frozenset()
    left = residuals_on(chain, names, other, rows, known=True)["resistance_dec"]
    z = (left / chain.facts.noise.marginal(np.nan_to_num(other.output)))[rows & np.isfinite(left)]
    return bends if z.size and np.sqrt(np.mean(z * z)) > UNSEEN else frozenset()


def _asked(chain: Chain, judged: Verdict, others: Sequence[Record]) -> dict[str, float]:
    """The channels in which others are predicted because something is left in this record, and of each by how many
    times an error with a name has to be that without it to speak against the name."""
    found = {}
    if chain.first is not None and chain.first.channel.misfit > 1.0 and any(o.current_A is not None for o in others):
        found["temperature_K"] = GROWS
    left = judged.resistance is not None and not judged.resistance.clean
    if left and any(other.output is not None for other in others):
        found["resistance_dec"] = 1.0
    return found


def _less(
    chain: Chain,
    judged: Verdict,
    others: Sequence[Record],
    half: tuple[Mask, ...],
    errors: Errors,
    channels: dict[str, float],
) -> Verdict:
    """Without the names that these rows of the others speak against. errors: of a set's prediction in all their rows,
    one record after the other; channels: as `_asked`."""
    for other, rows in zip(others, half, strict=True):
        if np.any(rows) and (bends := _bends_elsewhere(chain, judged.fitted, other, rows)):
            judged = judge(chain, judged.fitted - bends, judged, BENDS)
    asked = np.concatenate(half)

    def error(names: frozenset[str], channel: str) -> float:
        left = errors(names)[channel][asked]
        return float(np.sqrt(np.mean(left[np.isfinite(left)] ** 2))) if np.any(np.isfinite(left)) else 0.0

    for channel, grows in channels.items():
        while judged.names:
            with_all = error(judged.fitted, channel)
            without = {n: error(judged.fitted - {n}, channel) for n in judged.names}
            worst = min(without, key=lambda name: without[name])
            if with_all < grows * without[worst] or with_all == 0.0:
                break
            fewer = f"from {rough(without[worst])} to {rough(with_all)} {UNITS[channel]}"
            why = f"on another record the error grows with it {fewer}"
            judged = judge(chain, judged.fitted - {worst}, judged, why)
    return judged


def _predictions(chain: Chain, others: Sequence[Record]) -> Errors:
    """Of a set of effects, what is left of the others predicted from their currents, what is their own fitted to their
    first rows: by channel, one record after the other, nan without a reading; each set predicted once."""
    known: dict[frozenset[str], dict[str, Array]] = {}

    def of(names: frozenset[str]) -> dict[str, Array]:
        if names not in known:
            left = [residuals_on(chain, names, other, told_rows(other)) for other in others]
            none = [np.full(other.rows, np.nan) for other in others]
            known[names] = {
                channel: np.concatenate([one.get(channel, nan) for one, nan in zip(left, none, strict=True)])
                for channel in UNITS
            }
        return known[names]

    return of


def _correlated_s(chain: Chain, names: frozenset[str], other: Record) -> float:
    """For how long what is left hangs together: of the fit, and of the other record's prediction, which a room or a
    sink of its own takes off its course for minutes."""
    z, rows = (resistance_residual if chain.first is None else temperature_residual)(chain, names)
    longest = correlated_rows(z) * float(np.median(np.diff(chain.record.time_s[rows])))
    for left in residuals_on(chain, names, other, told_rows(other)).values():
        longest = max(longest, correlated_rows(left[np.isfinite(left)]) * other.interval_s)
    return longest
