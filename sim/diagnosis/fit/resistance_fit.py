"""What a fit of the last links looks for, and what it has found."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE
from sim.diagnosis.fit.film_prior import PriorWidths
from sim.effects.effect import Switched, at_the_terminals
from sim.model.record_own import FilmStart


@dataclass(frozen=True, eq=False)
class FilmParameters:
    """x: envelopes (4), change, exponent and percolation of how the phases mix (0 where they do not), effects, how far
    film filters are behind; film_output: of an earlier fit, (rows,), whose resistance the ohmmeter's current heats;
    None: the one that was read. mixes: whether relays are mixed otherwise than in their logarithms."""

    effects: tuple[Switched, ...]
    x: Array
    start: FilmStart
    prior: PriorWidths = field(default_factory=PriorWidths)
    film_output: Array | None = None
    mixes: bool = False

    @classmethod
    def of_the_class(cls, envelopes: Array, start: FilmStart, prior: PriorWidths | None = None) -> FilmParameters:
        """A Prandtl-Ishlinskii film with no effect. envelopes: (4,)."""
        x = np.concatenate((envelopes, np.zeros(SHAPE - ENVELOPES)))
        return cls((), x, start, PriorWidths() if prior is None else prior)

    @property
    def has_relays(self) -> bool:
        """Whether the film is of another kind."""
        return self.prior.relay_dec > 0.0

    @property
    def is_mixed(self) -> bool:
        """Whether there are relays, and are mixed."""
        return self.mixes and self.has_relays

    @property
    def nonlinear(self) -> list[int]:
        """Which of x bend the reading as a function of the resistance, or of the relays."""
        bends = [at_the_terminals(e.effect) for e in self.effects for q in e.effect.parameters if not q.choices]
        mixing = range(ENVELOPES, SHAPE) if self.is_mixed else ()
        return [*mixing, *(SHAPE + k for k, bent in enumerate(bends) if bent)]

    @property
    def unmixed(self) -> FilmParameters:
        """The same with phases that mix in their logarithms."""
        x = self.x.copy()
        x[ENVELOPES:SHAPE] = 0.0
        return replace(self, x=x, mixes=False)

    def with_relays(self, relay_dec: float) -> FilmParameters:
        """The same with relays of this prior's width, or none at 0."""
        return replace(self, prior=replace(self.prior, relay_dec=relay_dec))


@dataclass(frozen=True, eq=False)
class ResistanceFit:
    """parameters; shown: -log10 of the resistance shown, (rows,); film_output: of the film itself, (rows,); score: the
    marginal log-likelihood of the fitted rows (effects' and envelopes' parameters at their best); coefficients; cost:
    half of what is left, squared, and of the coefficients over their prior's widths."""

    parameters: FilmParameters
    shown: Array
    film_output: Array
    score: float
    coefficients: Array
    jacobian: Array
    minus_log: float
    cost: float
    plain: FilmParameters | None = None

    @property
    def without_relays(self) -> FilmParameters:
        """Those of the Prandtl-Ishlinskii film that it began from, or its own."""
        return self.plain or self.parameters.with_relays(0.0)

    @property
    def effects(self) -> tuple[Switched, ...]:
        return self.parameters.effects
