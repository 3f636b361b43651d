"""How far a fitted film can be trusted: standard errors of its parameters and 95 % bands of its predictions.

The prediction is linearized in everything that was fitted: outer parameters, D's coefficients, the offset and the
weights that are not at their bound 0. Their covariance is the block sandwich of
`sim.inference.covariance`. Where a path has moved in a sense whose envelope the records do not fix, the
band is infinite: the fitted envelope may be far from where the film's is, and its derivatives there say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.inference.covariance import NORMAL_95, Covariance, block_sandwich
from sim.inference.film.rows import Path


class Linearized(Protocol):
    """A fitted film that can give its prediction and the derivatives by its parameters along a path."""

    @property
    def outer_names(self) -> tuple[str, ...]:
        """Names of the nonlinear parameters: the first columns of `jacobian`."""
        ...

    @property
    def outer_values(self) -> Array:
        """Their values, shape (outer,)."""
        ...

    @property
    def parameters(self) -> float:
        """How many numbers the readings determine, the outer ones included."""
        ...

    def at(self, path: Path) -> Array:
        """Prediction at the path's readings, shape (readings,)."""
        ...

    def play_outputs(self, path: Path) -> Array:
        """Operator outputs at the path's readings, shape (readings, operators)."""
        ...

    @property
    def precision(self) -> Array | None:
        """Of the parameters' normal priors, over that of the readings, (parameters, parameters); None: no prior."""
        ...

    def jacobian(self, path: Path) -> Array:
        """d prediction / d parameters at the path's readings, shape (readings, parameters)."""
        ...


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of all k fitted parameters; the outer ones come first. open_sides: what of `Path.side` the records do
    not fix: 1 and -1, rows that the temperature rose or fell to; 2 and -2, first rows of a film heated or cooled."""

    fitted: Linearized
    covariance: Covariance
    open_sides: frozenset[int] = frozenset()

    @property
    def outer_standard_errors(self) -> Array:
        """Shape (outer,); inf where the records do not determine a parameter."""
        count = len(self.fitted.outer_names)
        return self.covariance.standard_errors[:count]

    def half_width(self, path: Path) -> Array:
        """Half the width of the 95 % band of the model's own curve at the path's readings, shape (readings,); inf where
        the path has moved in a sense that the records do not fix, until it has gone beyond all of it in the other."""
        jacobian = self.fitted.jacobian(path)
        square = np.sum((jacobian @ self.covariance.matrix) * jacobian, axis=1)
        half = NORMAL_95 * np.sqrt(np.maximum(square, 0.0))
        return np.where(_astray(path, self.open_sides)[path.rows], np.inf, half)


def uncertainty(fitted: Linearized, path: Path, residual: Array) -> Uncertainty:
    """From the rows of the fit and their residuals."""
    covariance = block_sandwich(fitted.jacobian(path), residual, precision=fitted.precision)
    taken = {int(side) for side in np.unique(path.side)}
    unfixed = set()
    for sense, word in ((1, "rising"), (-1, "falling")):
        names = zip(fitted.outer_names, covariance.undetermined, strict=False)
        if sense not in taken or any(lost and name.startswith(("log_" + word, word)) for name, lost in names):
            unfixed |= {sense, 2 * sense} - ({2 * sense} & taken)
    return Uncertainty(fitted, covariance, frozenset(unfixed))


def _astray(path: Path, open_sides: frozenset[int]) -> NDArray[np.bool_]:
    """Rows at which the film remembers a move that the records do not fix, shape (rows of the path,).

    Beyond the furthest that it came in the other sense a film forgets all that was in between.
    """
    found = np.zeros(path.inputs.size, dtype=np.bool_)
    if not open_sides:
        return found
    astray, forgets, low, high = False, 0, 0.0, 0.0
    for row, (v, side) in enumerate(zip(path.inputs.tolist(), path.side.tolist(), strict=True)):
        if abs(side) == 2:
            astray, forgets, low, high = side in open_sides, int(np.sign(side)), v, v
            forgets = 0 if astray else forgets
        elif side in open_sides:
            astray = True
        elif side == forgets and (v >= high if side > 0 else v <= low):
            astray = False
        found[row], low, high = astray, min(low, v), max(high, v)
    return found
