"""Play and generalized play operators, sample by sample and compiled: paper eqs (1)-(6) and (9).

    rising   (v > v before):  w_j = max(gamma_R(v) - r_j, w_j)
    falling  (v < v before):  w_j = min(gamma_L(v) + r_j, w_j)
    at rest:                  w_j stays
    output                    u   = D(v) + sum_j p_j w_j

The classical play operator is the case gamma_R(v) = gamma_L(v) = v. `envelopes` holds a row
(code_R, a_R, b_R, code_L, a_L, b_L) for all operators together, or a row for each operator.
"""

from __future__ import annotations

from numba import njit

from compensator.functions import Array, envelope_value, memoryless


@njit(cache=True)
def advance(v: float, v_before: float, envelopes: Array, radii: Array, memory: Array) -> None:
    """Move every operator to the input v, in place: eq (6)."""
    count = radii.size
    if v > v_before:
        if envelopes.shape[0] == 1:
            gamma = envelope_value(envelopes[0, 0], envelopes[0, 1], envelopes[0, 2], v)
            for j in range(count):
                memory[j] = max(gamma - radii[j], memory[j])
        else:
            for j in range(count):
                gamma = envelope_value(envelopes[j, 0], envelopes[j, 1], envelopes[j, 2], v)
                memory[j] = max(gamma - radii[j], memory[j])
    elif v < v_before:
        if envelopes.shape[0] == 1:
            gamma = envelope_value(envelopes[0, 3], envelopes[0, 4], envelopes[0, 5], v)
            for j in range(count):
                memory[j] = min(gamma + radii[j], memory[j])
        else:
            for j in range(count):
                gamma = envelope_value(envelopes[j, 3], envelopes[j, 4], envelopes[j, 5], v)
                memory[j] = min(gamma + radii[j], memory[j])


@njit(cache=True)
def weighted_sum(weights: Array, memory: Array) -> float:
    """sum_j p_j w_j in a fixed order of additions, so that every caller gets the same bits."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0  # eight lanes: one vector register
    count = weights.size
    whole = count - count % 8
    for j in range(0, whole, 8):
        s0 += weights[j] * memory[j]
        s1 += weights[j + 1] * memory[j + 1]
        s2 += weights[j + 2] * memory[j + 2]
        s3 += weights[j + 3] * memory[j + 3]
        s4 += weights[j + 4] * memory[j + 4]
        s5 += weights[j + 5] * memory[j + 5]
        s6 += weights[j + 6] * memory[j + 6]
        s7 += weights[j + 7] * memory[j + 7]
    for j in range(whole, count):
        s0 += weights[j] * memory[j]
    return ((s0 + s4) + (s2 + s6)) + ((s1 + s5) + (s3 + s7))


@njit(cache=True)
def run(
    inputs: Array,
    v_before: float,
    memory: Array,
    film: tuple[Array, Array, Array, int, Array],
    outputs: Array,
) -> None:
    """Outputs u for a sequence of inputs v (degC), eq (9); `memory` is left at the last sample.

    film: (envelopes, radii, weights, code of D, parameters of D).
    """
    envelopes, radii, weights, code, par = film
    for i in range(inputs.size):
        v = inputs[i]
        advance(v, v_before, envelopes, radii, memory)
        outputs[i] = memoryless(code, par, v)[0] + weighted_sum(weights, memory)
        v_before = v


@njit(cache=True)
def play_outputs(inputs: Array, v_before: float, memory: Array, envelopes: Array, radii: Array, outputs: Array) -> None:
    """Output of each operator for a sequence of inputs: outputs has the shape (samples, operators)."""
    for i in range(inputs.size):
        advance(inputs[i], v_before, envelopes, radii, memory)
        v_before = inputs[i]
        for j in range(radii.size):
            outputs[i, j] = memory[j]
