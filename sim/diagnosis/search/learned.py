"""What is learned of a record on the way: another chain, searched anew where that matters.

The noise is estimated from what a fit leaves, and so are outliers and missing rows; with more effects known it is known
better. Each function takes a chain and the effects by which it learns, and gives the chain that knows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.record import Record, Rows
from sim.diagnosis.data.residual_outliers import outlying_rows
from sim.diagnosis.data.segments import off_after_missing_rows
from sim.diagnosis.fit.channel_noise import ohmmeter_noise, thermometer_noise
from sim.diagnosis.fit.domain_noise import domain_noise
from sim.diagnosis.fit.film_memory import remembered
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.fit.temperature_channel import TemperatureChannel
from sim.diagnosis.search.chain import LEAST_NOISE_K, Chain, Found
from sim.diagnosis.search.film_facts import LEAST_NOISE_DEC, FilmFacts, film_facts, least_noise

DOMAIN_TURNS = 5  # of a fit and the domains that it shows: each settles the other, and in the fifth little changes
SAME_DOMAINS = 0.15  # relative difference of two estimates of their noise that is none
SAME_NOISE = 0.06  # relative difference of two estimates of a noise that is none
NEAR_STEPS = 10  # of a fit that only the weights of its rows have changed for


def with_film(chain: Chain, upstream: frozenset[str]) -> Chain:
    """With the film's facts, of the path behind these effects of the first links; nothing of the film found yet."""
    facts = film_facts(chain.record, chain.path(upstream), chain.curve, chain.relays, chain.unsure)
    record = chain.record.without(facts.outliers[:0], facts.outliers)
    return replace(chain, record=record, as_read=chain.as_read or chain.record, facts=facts, found=Found())


def first_renoised(chain: Chain, upstream: frozenset[str]) -> Chain:
    """With the first channel weighed by the noise that the fit with these effects leaves, without the readings that it
    shows to be outliers, in stretches that begin where it shows that a row is missing; the same chain where nothing
    changes. What a fit with too few effects took for an outlier comes back. The film is not known yet."""
    old, before = chain.first, chain.record
    assert old is not None
    whole, fit = chain.as_read or before, old.fit(upstream)
    noise = thermometer_noise(old.channel, fit, LEAST_NOISE_K, "thermometer" in chain.coloured)
    outliers = outlying_rows(before.temperature_degC, fit.shown_degC, whole.temperature_used, 0.5 * before.step_K)
    record = whole.without(outliers, outliers[:0])
    left = np.where(record.temperature_used, (before.temperature_degC - fit.shown_degC) / noise.level, np.nan)
    off = off_after_missing_rows(left, before.time_s, before.first_rows)
    same = np.array_equal(record.temperature_used, before.temperature_used) and not off.size
    if same and noise.alike(old.channel.noise, before.temperature_degC[:1], SAME_NOISE):
        return chain
    record = record.begun_also(off)
    channel = TemperatureChannel(record, ~record.held_out, noise, record.step_K)
    base = replace(old.base, parameters=channel.in_its_stretches(old.base))
    near = {key: channel.in_its_stretches(known) for key, known in old.fits.items() if key <= upstream}
    fits = {key: channel.descend(p, NEAR_STEPS) for key, p in near.items()}
    first = replace(old, channel=channel, base=base, fits=fits)
    return replace(chain, record=record, as_read=whole.begun_also(off), first=first)


def last_renoised(chain: Chain, names: frozenset[str]) -> tuple[Chain, bool]:
    """The same of the last channel, with the memory that fits best beside these effects; and whether effects have to be
    selected anew for it: what only comes back was fitted without being seen."""
    upstream, _ = chain.split(names)
    before, facts, b = chain.record, chain.facts, chain.fits(names)[1]
    if b is None or facts is None or before.output is None:
        return chain, False
    whole, channel = chain.as_read or before, chain.last(upstream).channel
    noise = ohmmeter_noise(channel, b, LEAST_NOISE_DEC, chain.unsure, "ohmmeter" in chain.coloured)
    record, outliers = _less_outliers(before, whole, b, noise)
    start, used = remembered(channel, b.parameters), before.output_used
    same = noise.alike(facts.noise, before.output[used], SAME_NOISE) and start == facts.start
    same = same and not np.any(used[outliers])
    if same and np.array_equal(record.output_used, used):
        return chain, False
    chain = replace(chain, record=record, facts=replace(facts, noise=noise, start=start), found=Found())
    search = chain.last(upstream)
    search.keep(search.whole(replace(b.plain or b.parameters, start=start)))
    return chain, not same


def _less_outliers(before: Record, whole: Record, b: ResistanceFit, noise: NoiseModel) -> tuple[Record, Rows]:
    """The whole record without the film's readings that a fit shows to be outliers beside this noise, and these; the
    thermometer's stay as they were."""
    assert before.output is not None
    outliers = outlying_rows(before.output, b.shown, whole.output_used, least_noise(noise, before.output))
    return whole.without(np.flatnonzero(whole.temperature_used & ~before.temperature_used), outliers), outliers


def with_domains(chain: Chain, names: frozenset[str]) -> Chain:
    """With domains that switch visibly, as what is left beside these effects shows them, fitted with these effects; no
    reading is an outlier there for what they do."""
    for _ in range(DOMAIN_TURNS):
        b, facts, before = chain.fits(names)[1], chain.facts, chain.record
        assert b is not None
        assert facts is not None
        domains = domain_noise(chain.film_channel(names), b, LEAST_NOISE_DEC)
        record, _ = _less_outliers(before, chain.as_read or before, b, domains.noise)
        same = facts.domains is not None and domains.alike(facts.domains, SAME_DOMAINS)
        facts = replace(facts, noise=domains.noise, domains=domains)
        chain = _refitted(replace(chain, record=record), names, facts)
        if same:
            break
    return chain


def _refitted(chain: Chain, names: frozenset[str], facts: FilmFacts) -> Chain:
    """With other facts of the film, fitted with these effects from where it was; at first as if its phases mixed in
    their logarithms: what looked like another mixing may have been steps."""
    b, first = chain.fits(names)[1], chain.facts is None or chain.facts.domains is None
    assert b is not None
    chain = replace(chain, facts=facts, found=Found(), together=False)
    search = chain.last(chain.split(names)[0])
    p = b.plain or b.parameters
    search.keep(search.whole(p.unmixed if first else p))
    return chain
