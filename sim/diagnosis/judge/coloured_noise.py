"""An instrument whose noise has a colour: what seems left is judged with the spectrum that it shows within seconds.

A record's noise is taken to be white, or such that neighbouring rows share a part. A filter in an instrument, or 1/f
noise, leaves more than that, and the record is "unexplained" with nothing wrong in it. Where all that is left in a
channel would be nothing beside noise of the colour that it shows from row to row, the record is searched anew with such
noise there. What is said then counts where it leaves nothing in that channel: what is slow, hangs on temperature,
current or resistance, or has a period, is no such noise. The other channel may have a fault, or a film in steps: where
both are tried together and one leaves something, the other is tried alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from sim.diagnosis.fit.channel_noise import ohmmeter_noise, thermometer_noise
from sim.diagnosis.judge.verdict import Verdict, judge
from sim.diagnosis.search.both_ends import select
from sim.diagnosis.search.budget import JUDGING
from sim.diagnosis.search.chain import LEAST_NOISE_K, Chain
from sim.diagnosis.search.film_facts import LEAST_NOISE_DEC
from sim.diagnosis.search.stepwise import Progress
from sim.diagnosis.validate.adequacies import of_resistance, of_temperature

TRIALS: Final = 3  # both, one alone, and the other: what it leaves may show only beside the first's colour
Judged = tuple[Chain, frozenset[str], Verdict]


def beside_coloured_noise(begun: Chain, found: Judged, say: Progress) -> Judged:
    """What is said with such noise, or what was found as it is where the record shows none. begun: nothing was searched
    yet; found: the chain, the effects that the search found, and what is said of them."""
    refused = frozenset[str]()
    for _ in range(TRIALS):
        chain, _, judged = found
        if judged.clean or chain.sparse is not None or chain.budget.over(JUDGING):
            break
        passing = frozenset(_passing(chain, judged)) - refused
        if not passing or "thermometer" in refused:  # what drives the film is not understood
            break
        say("noise of another colour")
        other, names = select(replace(begun, coloured=chain.coloured | passing), say)
        told = judge(other, names)
        left = _left(told) & other.coloured
        if not left:
            found = (other, names, told)
        elif not left & passing:
            break
        refused |= left
    return found


def _passing(chain: Chain, judged: Verdict) -> list[str]:
    """The instruments of which all that is left passes for such noise; none where the thermometer's does not: whatever
    drives the film is not understood then."""
    left, found = _left(judged) - chain.coloured, list[str]()
    if "thermometer" in left:
        if not _passes_in_temperature(chain, judged.fitted):
            return []
        found.append("thermometer")
    if "ohmmeter" in left and _passes_in_resistance(chain, judged.fitted):
        found.append("ohmmeter")
    return found


def _left(judged: Verdict) -> frozenset[str]:
    """The instruments in whose channel something is left."""
    of = {"thermometer": judged.temperature, "ohmmeter": judged.resistance}
    return frozenset(instrument for instrument, left in of.items() if left is not None and not left.clean)


def _passes_in_temperature(chain: Chain, names: frozenset[str]) -> bool:
    """Whether what is left in the thermometer's channel passes for such noise."""
    assert chain.first is not None
    channel, fit = chain.first.channel, chain.fits(names)[0]
    assert fit is not None
    noise = thermometer_noise(channel, fit, LEAST_NOISE_K, coloured=True)
    if noise.colour is None:
        return False
    rows, readings = channel.rows, channel.record.temperature_degC
    z = noise.on(rows, readings[rows]).over((readings - fit.shown_degC)[rows])
    return of_temperature(chain, names, z, rows, noise).clean


def _passes_in_resistance(chain: Chain, names: frozenset[str]) -> bool:
    """The same of the ohmmeter's."""
    channel, fit = chain.film_channel(names), chain.fits(names)[1]
    assert fit is not None
    noise = ohmmeter_noise(channel, fit, LEAST_NOISE_DEC, chain.unsure, coloured=True)
    if noise.colour is None:
        return False
    rows, output = channel.rows, channel.output
    z = noise.on(rows, output[rows]).over((output - fit.shown)[rows])
    return of_resistance(chain, names, z, rows, noise).clean
