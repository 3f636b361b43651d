"""A diagnosis of a film whose output is no resistance, in that output's own name and unit.

Every film is fitted in decades of an output that falls with temperature (data/quantity.py says how many of its own unit
a decade of it stands for); who reads the diagnosis reads the unit of the record.
"""

from __future__ import annotations

from dataclasses import replace

from sim.diagnosis.report.candidates import Candidate
from sim.diagnosis.result import Diagnosis, Finding
from sim.diagnosis.validate.gain import Gain


def in_its_unit(found: Diagnosis) -> Diagnosis:
    """What was fitted in decades and is another quantity of the film, by its own name and in its own unit."""
    quantity = found.record.quantity
    if quantity.is_resistance:
        return found
    key, size = quantity.channel, quantity.size

    def gains(finding: Finding) -> dict[str, Gain]:
        g = dict(finding.gain)
        if (own := g.pop("resistance_dec", None)) is not None:
            g[key] = replace(own, rmse_before=size * own.rmse_before, rmse_after=size * own.rmse_after)
        return g

    def scaled(rmse: dict[str, float]) -> dict[str, float]:
        return {key if c == "resistance_dec" else c: v * size if c == "resistance_dec" else v for c, v in rmse.items()}

    def renamed(c: Candidate) -> Candidate:
        intervals_of = {key if name == "resistance_dec" else name: ci for name, ci in c.reduction_ci95.items()}
        named, holdout = scaled(c.rmse_named), scaled(c.rmse_holdout)
        return replace(c, rmse_named=named, rmse_holdout=holdout, reduction_ci95=intervals_of)

    candidates = [renamed(c) for c in found.candidates]
    channels, own = dict(found.channels), found.channels["resistance_dec"]
    if own is not None:
        noise, before, after, expected = (size * v for v in (own.noise, own.rmse_base, own.rmse_extended, own.expected))
        own = replace(own, noise=noise, rmse_base=before, rmse_extended=after, expected=expected)
    channels |= {"resistance_dec": None, key: own}
    unexplained = {**found.unexplained, "resistance_dec": None, key: found.unexplained["resistance_dec"]}
    findings = [replace(f, gain=gains(f)) for f in found.findings]
    return replace(found, channels=channels, unexplained=unexplained, findings=findings, candidates=candidates)
