"""How far a fitted film can be trusted: standard errors of its parameters and 95 % bands of its predictions.

The prediction is linearized in everything that was fitted: outer parameters, D's coefficients, the offset and the
weights that are not at their bound 0. Their covariance is the block sandwich of
`compensator.identification.covariance`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.identification.covariance import NORMAL_95, Covariance, block_sandwich
from compensator.identification.rows import Path


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
    def parameters(self) -> int:
        """How many numbers were fitted, the outer ones included."""
        ...

    def play_outputs(self, path: Path) -> Array:
        """Operator outputs at the path's readings, shape (readings, operators)."""
        ...

    def jacobian(self, path: Path) -> Array:
        """d prediction / d parameters at the path's readings, shape (readings, parameters)."""
        ...


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of all k fitted parameters; the outer ones come first."""

    fitted: Linearized
    covariance: Covariance

    @property
    def outer_standard_errors(self) -> Array:
        """Shape (outer,); inf where the records do not determine a parameter."""
        count = len(self.fitted.outer_names)
        return self.covariance.standard_errors[:count]

    def half_width(self, path: Path) -> Array:
        """Half the width of the 95 % band of the model's own curve at the path's readings, shape (readings,)."""
        jacobian = self.fitted.jacobian(path)
        square = np.sum((jacobian @ self.covariance.matrix) * jacobian, axis=1)
        return np.asarray(NORMAL_95 * np.sqrt(np.maximum(square, 0.0)), dtype=np.float64)


def uncertainty(fitted: Linearized, path: Path, residual: Array) -> Uncertainty:
    """From the rows of the fit and their residuals."""
    return Uncertainty(fitted, block_sandwich(fitted.jacobian(path), residual))
