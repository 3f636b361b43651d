"""memoryless_term (film): a part D(T) that the play operators cannot carry.

    y = sum_j p_j F_j[T] + D(T)

It belongs to the base model; it is an effect only where the base was restricted to a generalized model. Which form
(tanh, Arrhenius, ...) describes it best is said under `film`. Source: the extended model of the paper, eq (9).
"""

from __future__ import annotations

NAME = "memoryless_term"
