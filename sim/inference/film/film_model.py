"""The film of a fit as a model file has it: D(T) of a named form, and operators with their envelopes."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.optimize import least_squares

from compensator.hysteresis.film import Envelope, FilmModel
from compensator.hysteresis.functions import Array
from sim.inference.film.memoryless_forms import Form
from sim.inference.joint.films import NamedCurve, PIFilm, PreisachFilm
from sim.inference.joint.likelihood import Fit

STARTS: Final = 5, 48  # of the nonlinear parameters of a form, each of two; of one, which may be a wave's frequency
NEGLIGIBLE: Final = 1e-6  # of all weights: below it an operator counts as absent


def nearest_curve(form: Form, degC: Array, curve: Array) -> NamedCurve:
    """Return the curve of a form that comes nearest to a curve at some temperatures."""
    if form.parameters == 0:
        return NamedCurve(form, np.empty(0))
    low, high = form.bounds()

    def left(shape: Array) -> Array:
        columns = np.column_stack((np.ones(degC.size), form.columns(degC, shape)))
        return np.asarray(curve - columns @ np.linalg.lstsq(columns, curve)[0])

    count = STARTS[0] if low.size > 1 else STARTS[1]
    axes = [np.linspace(a, b, count + 2)[1:-1] for a, b in zip(low, high, strict=True)]
    starts = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, low.size)
    first = min(starts, key=lambda shape: float(np.sum(left(shape) ** 2)))
    return NamedCurve(form, np.asarray(least_squares(left, first, bounds=(low, high)).x))


def film_model(fit: Fit, kind: str | None = None) -> FilmModel:
    """Return the film of a fit whose D has a name, in the fit's decades. kind: of a PI film, None: by its D."""
    film, c = fit.joint.film, fit.at.coefficients
    assert isinstance(film, PIFilm | PreisachFilm)
    values = fit.at.x[fit.joint.is_film]
    curve = film.curve_at(values) if isinstance(film, PIFilm) else film.curve
    assert isinstance(curve, NamedCurve)
    split = 1 + curve.count
    memoryless, weights = curve.form.memoryless(c[1:split], curve.shape, float(c[0])), c[split:]
    kept = weights > NEGLIGIBLE * float(np.sum(weights))
    kept[0] |= not np.any(kept)  # a film without any hysteresis
    if isinstance(film, PIFilm):
        slopes, centres = np.exp(values[[0, 2]]), values[[1, 3]]
        rising, falling = (Envelope("tanh", a, -a * c) for a, c in zip(slopes.tolist(), centres.tolist(), strict=True))
        kind = kind or ("generalized_pi" if memoryless.function == "none" else "extended_generalized_pi")
        radii = film.radii(values)[kept]
        return FilmModel(radii, weights[kept], rising, falling, memoryless, kind, initial=film.start.initial)
    relays = film.density.only(kept)
    radii = np.zeros(relays.centre.size)
    envelopes = relays.envelopes()
    return FilmModel(radii, weights[kept], *envelopes, memoryless, "mixed_envelopes", initial=film.start.initial)
