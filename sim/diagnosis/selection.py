"""The likeliest set of effects of a record, with one kind of plate, and whether its film needs a D(T)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from compensator.thermal.plate import Kind
from sim.diagnosis.result import Sizes
from sim.diagnosis.search import Search
from sim.effects.effect import Effect
from sim.inference.evidence import price
from sim.inference.joint.films import PIFilm, PreisachFilm
from sim.inference.joint.likelihood import Fit, Module
from sim.inference.joint.starts import plate_fit, with_first_film
from sim.inference.record.record import Record
from sim.model.film_columns import SmoothCurve

SURE: Final = 0.5 * 4.0**2  # log-likelihood: a drive that moves a plate is worth thousands
DEGREES: Final = 3  # parameters of a usual D(T): amplitude, slope, centre
PLACES: Final = 200  # of temperatures: D is smooth


@dataclass(frozen=True, eq=False)
class Selected:
    """The likeliest set: base and extended fit, the search with all sets that were fitted; drive_moves: the drive has a
    coefficient that is not 0; memoryless: parameters and evidence of a D(T) that a base without one needs."""

    base: Fit
    fit: Fit
    search: Search
    drive_moves: bool = True
    memoryless: tuple[Sizes, float] | None = None

    def without_memoryless(self, record: Record, decides: bool) -> Selected:
        """Return the selection with a base whose film has no D(T); the extended fit has one if its gain exceeds its
        price, and the record decides about its film."""
        if self.fit.joint.film is None:
            return self
        base, flat = _without_curve(self.base), _without_curve(self.fit)
        evidence = self.fit.log_likelihood - flat.log_likelihood
        if not decides or evidence <= price(DEGREES, self.fit.joint.rows_dec.size):
            return replace(self, base=base, fit=flat)
        return replace(self, base=base, memoryless=(_span(self.fit, record), evidence))


def selected(record: Record, kinds: Sequence[Kind], assumed: Sequence[Effect], search: Search) -> Selected:
    """Select the effects of a record, among those of the search, and the kind of plate. assumed: those that are there.

    First those that the temperature shows by itself, with no film in the way; then, along the path that they give, all.
    """
    plate = plate_fit(record, kinds)
    moves, every = not plate.joint.driven or drive_moves(plate), search.effects
    if not moves:
        search.effects = [effect for effect in search.effects if effect.link not in ("driver", "plate")]
    alone = plate
    if plate.joint.driven:
        alone = search.run(search.assuming(plate, [effect for effect in assumed if effect.before_film]))
        if not moves and drive_moves(alone):  # behind a thermometer that lags it looks as if it did not
            moves, search.effects = True, every
            alone = search.run(alone)
        for kind in kinds:
            if moves and not search.over() and kind != alone.joint.kind:
                other = search.with_module(alone, Module(kind))
                if search.value(other) > search.value(alone):
                    plate, alone = plate_fit(record, (kind,)), search.run(other)
    if record.output is None:
        return Selected(plate, alone, search, moves)
    search.table.clear()
    have = {effect.name for effect in alone.effects}
    beside = [effect for effect in assumed if effect.name not in have]
    first = search.assuming(with_first_film(alone), beside)
    base = first if len(first.effects) == len(assumed) else _beside_film(plate, first, assumed)
    return Selected(base, search.run(first), search, moves)


def _beside_film(plate: Fit, fit: Fit, effects: Sequence[Effect]) -> Fit:
    """Return a plate with another fit's film, and with some of its effects."""
    joint = fit.joint.having(effects, module=plate.joint.module)
    own = [name for name in plate.joint.names if name in joint.place]
    x = joint.from_other(fit.joint, fit.at.x)
    x[[joint.place[name] for name in own]] = plate.at.x[[plate.joint.place[name] for name in own]]
    most = plate.most[0], fit.most[1]
    return joint.fit(x, fit.metric.of(plate.metric.temperature, fit.metric.output), fit.at.known_own, most=most)


def drive_moves(fit: Fit) -> bool:
    """Return False if all coefficients of the drive are as good as 0: it does not move the plate."""
    places = [fit.joint.place[name] for name in ("s", "r", "q") if name in fit.joint.place]
    found, by = fit.covariance(), fit.at.x[places]
    known = found.matrix[np.ix_(places, places)]
    # together: a current that only heats leaves both open
    return 0.5 * float(by @ np.linalg.lstsq(known, by)[0]) > SURE


def _without_curve(fit: Fit) -> Fit:
    """Return the fit with a film without D(T)."""
    film = fit.joint.film
    assert isinstance(film, PIFilm | PreisachFilm)
    assert isinstance(film.curve, SmoothCurve)
    none = SmoothCurve(film.curve.knots, film.curve.cubics[:, :, :0])
    joint = fit.joint.having(fit.effects, replace(film, curve=none))
    return joint.fit(fit.at.x, fit.metric, fit.at.known_own, most=fit.most)


def _span(fit: Fit, record: Record) -> Sizes:
    """Return over how much D(T) goes within the film's temperatures, in the output's unit."""
    film, nodes = fit.joint.film, fit.at.run.nodes
    assert isinstance(film, PIFilm | PreisachFilm)
    assert nodes is not None
    degC = np.linspace(float(np.min(nodes.film_degC)), float(np.max(nodes.film_degC)), PLACES)
    span = float(np.ptp(film.curve.columns(degC) @ fit.at.coefficients[1 : film.free]))
    return {f"span_{record.quantity.unit}": (record.quantity.size * span, None)}
