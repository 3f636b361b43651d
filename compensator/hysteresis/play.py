"""Play and generalized play operators, sample by sample and compiled: paper eqs (1)-(6) and (9).

    rising   (v > v before):  w_j = max(gamma_R(v) - r_j, w_j)
    falling  (v < v before):  w_j = min(gamma_L(v) + r_j, w_j)
    at rest:                  w_j stays
    output                    u   = D(v) + sum_j p_j w_j

The classical play operator is the case gamma_R(v) = gamma_L(v) = v. `envelopes` holds a row
(code_R, a_R, b_R, code_L, a_L, b_L) for all operators together, or a row for each operator.
"""

from __future__ import annotations

from compensator.compiled import njit
from compensator.hysteresis.functions import Array, envelope_value, memoryless_value


@njit
def move(side: float, gamma: float, radii: Array, memory: Array) -> None:
    """Move every operator to the envelope's value gamma, rising (side +1) or falling (-1), in place: eq (6)."""
    if side > 0.0:
        for j in range(radii.size):
            memory[j] = max(gamma - radii[j], memory[j])
    else:
        for j in range(radii.size):
            memory[j] = min(gamma + radii[j], memory[j])


@njit
def advance(v: float, v_before: float, envelopes: Array, radii: Array, memory: Array) -> None:
    """Move every operator to the input v, in place: eq (6)."""
    if v > v_before:
        side, first = 1.0, 0
    elif v < v_before:
        side, first = -1.0, 3
    else:
        return
    if envelopes.shape[0] == 1:
        gamma = envelope_value(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v)
        move(side, gamma, radii, memory)
        return
    for j in range(radii.size):
        gamma = envelope_value(envelopes[j, first], envelopes[j, first + 1], envelopes[j, first + 2], v)
        memory[j] = max(gamma - radii[j], memory[j]) if side > 0.0 else min(gamma + radii[j], memory[j])


@njit
def weighted_sum(weights: Array, memory: Array) -> float:
    """Return sum_j p_j w_j, added in a fixed order, so that every caller gets the same bits."""
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


@njit
def output_of(film: tuple[Array, Array, Array, int, Array], v: float, memory: Array) -> float:
    """Return the output u of a film at v (degC) with this memory, eq (9). film: as of `run`."""
    _, _, weights, code, par = film
    return memoryless_value(code, par, v) + weighted_sum(weights, memory)


@njit
def run(
    inputs: Array,
    v_before: float,
    memory: Array,
    film: tuple[Array, Array, Array, int, Array],
    outputs: Array,
) -> float:
    """Fill outputs u for a sequence of inputs v (degC), eq (9), and return the last input; `memory` ends there.

    At an input of nan the output is nan, the operators rest, and the next input moves them from the last known one.

    film: (envelopes, radii, weights, code of D, parameters of D).
    """
    envelopes, radii, weights, code, par = film
    if envelopes.shape[0] > 1:
        for i in range(inputs.size):
            v = inputs[i]
            advance(v, v_before, envelopes, radii, memory)
            outputs[i] = memoryless_value(code, par, v) + weighted_sum(weights, memory)
            if v == v:
                v_before = v
            else:
                outputs[i] = v
        return v_before
    code_r, a_r, b_r = (
        envelopes[0, 0],
        envelopes[0, 1],
        envelopes[0, 2],
    )  # read once: half the time of a sample
    code_l, a_l, b_l = envelopes[0, 3], envelopes[0, 4], envelopes[0, 5]
    for i in range(inputs.size):
        v = inputs[i]
        if v > v_before:
            move(1.0, envelope_value(code_r, a_r, b_r, v), radii, memory)
        elif v < v_before:
            move(-1.0, envelope_value(code_l, a_l, b_l, v), radii, memory)
        outputs[i] = memoryless_value(code, par, v) + weighted_sum(weights, memory)
        if v == v:
            v_before = v
        else:
            outputs[i] = v
    return v_before


@njit
def play_outputs(inputs: Array, v_before: float, memory: Array, envelopes: Array, radii: Array, outputs: Array) -> None:
    """Fill each operator's output for a sequence of inputs: outputs has the shape (samples, operators)."""
    for i in range(inputs.size):
        advance(inputs[i], v_before, envelopes, radii, memory)
        if inputs[i] == inputs[i]:
            v_before = inputs[i]
        for j in range(radii.size):
            outputs[i, j] = memory[j]
