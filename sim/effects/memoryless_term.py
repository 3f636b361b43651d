"""memoryless_term (film): a part D(T) that the play operators cannot carry.

    y = sum_j p_j F_j[T] + D(T),   D(T) = c_1 x + c_2 x^2 + c_3 x^3,   x = (T - 60 degC) / 20 K

It belongs to the base model; it is an effect only where the base was restricted to a generalized model. Which form
(tanh, Arrhenius, ...) describes it best is said under `film`. Source: the extended model of the paper, eq (9).
"""

from __future__ import annotations

NAME = "memoryless_term"
CENTRE_DEGC, SCALE_K = 60.0, 20.0  # of x: -1 to 1 over the transition, so that the coefficients are of one size
