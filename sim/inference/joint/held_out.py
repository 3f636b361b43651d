"""Errors on rows of a record that no fit has seen: of the simulation from the recorded current, without any
discrepancy.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from sim.inference.joint.likelihood import Fit, Joint, Point
from sim.inference.joint.starts import first_metric
from sim.model.recorded import Mask

HELD_STEPS = 6  # of a fit without the held-out rows, from the fit with them


def simulated(fit: Fit) -> Point:
    """A fit's simulation from the recorded current (or temperature), its plate's discrepancy left out."""
    fit = fit.for_simulation
    return _plain(fit.joint.on(fit.joint.record, fit.at.coefficients), fit.at)


def residuals(joint: Joint, at: Point) -> dict[str, Array]:
    """By channel what was read less what the simulation shows, (rows,), nan where no reading counts. joint: with the
    film's coefficients known."""
    record, plain, found = joint.record, _plain(joint, at), {}
    if joint.driven:
        left = record.temperature_degC - plain.run.shown_degC
        found["temperature_K"] = np.where(record.temperature_used, left, np.nan)
    if joint.film is not None and record.output is not None:
        found["resistance_dec"] = np.where(record.output_used, record.output - plain.shown_dec, np.nan)
    return found


def _plain(joint: Joint, at: Point) -> Point:
    """A point's simulation by the plate's model alone, its path not corrected by the thermometer."""
    metric = first_metric(joint) if joint.driven else replace(first_metric(joint), simulated=False)
    return joint.solve(at.x, metric, at.own if at.own.size == joint.record.time_s.size else None)


def without_rows(fit: Fit, held: Mask) -> Fit:
    """The fit without the held-out rows' readings."""
    record: Any = fit.joint.record
    used = record.temperature_used & ~held if fit.joint.driven else record.temperature_used
    fewer = replace(record, temperature_used=used, output_used=record.output_used & ~held)
    joint = fit.joint.on(fewer)
    at_K, at_dec = joint.readings()
    output = fit.metric.output
    if output is not None:
        kept = np.isin(fit.joint.rows_dec, joint.rows_dec)
        domains = output.domains
        if domains is not None:
            domains = replace(domains, columns=domains.columns[kept], rest=domains.rest[kept])
        output = replace(output, readings=at_dec, domains=domains)
    metric = replace(fit.metric, temperature=replace(fit.metric.temperature, readings=at_K), output=output)
    own = fit.at.known_own
    at = joint.descend(joint.solve(fit.at.x, metric, own), metric, HELD_STEPS)
    return Fit(joint, at, metric, joint.log_likelihood(at, metric))


def errors_in(fit: Fit, held: Mask) -> dict[str, Array]:
    """Residuals of a fit without some rows, in these rows, nan elsewhere, by channel."""
    less = without_rows(fit, held).for_simulation
    whole = fit.joint.on(fit.joint.record, less.at.coefficients)
    return {name: np.where(held, left, np.nan) for name, left in residuals(whole, less.at).items()}
