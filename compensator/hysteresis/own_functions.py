"""Envelope and memoryless functions of a user's own, under a name, for compiled loops that were compiled without them.

    register_envelope("arctan", value=math.atan, slope=lambda s: 1.0 / (1.0 + s * s), inverse=math.tan,
                      low=-math.pi / 2, high=math.pi / 2)
    Envelope("arctan", a=0.2, b=-13.0)                    # gamma(v) = arctan(0.2 v - 13)

    register_memoryless("gauss", value=lambda s: math.exp(-s * s), ...)
    Memoryless("gauss", amplitude=0.3, a=0.1, b=-6.5)     # D(v) = 0.3 exp(-(0.1 v - 6.5)^2) + offset

A function is compiled for machine code where numba can, else called back as it is (slower, the same result). The
loops get its address with the model's parameters, so that they are compiled once for all functions, and cached.
An address holds for one process only: `FilmModel` leaves it out of a pickle and looks the name up again.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import cfunc, types
from numba.core.errors import NumbaError
from numba.extending import intrinsic
from numpy.typing import NDArray

Scalar = Callable[[float], float]

VALUE, SLOPE, THIRD, LOW, HIGH, INFLECTION = range(6)  # places in a function's table
BUILT_IN_CODES: Final = (
    100  # codes below are the functions of `compensator.hysteresis.functions`, others are addresses of tables
)

_kept: list[Any] = []  # compiled functions and tables live as long as the process
_envelopes: dict[str, int] = {}
_memoryless: dict[str, int] = {}


@intrinsic
def _call_at(typing_context: Any, table: Any, place: Any, s: Any) -> Any:
    """Call the function float -> float whose address stands at a place of the table."""
    signature = types.float64(types.int64, types.int64, types.float64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        base = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
        address = builder.load(builder.gep(base, [arguments[1]]))
        function = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()])
        return builder.call(builder.inttoptr(address, function.as_pointer()), [arguments[2]])

    return signature, generate


@intrinsic
def _number_at(typing_context: Any, table: Any, place: Any) -> Any:
    """Return the float64 that stands at a place of the table."""
    signature = types.float64(types.int64, types.int64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        base = builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())
        return builder.load(builder.gep(base, [arguments[1]]))

    return signature, generate


call_at: Any = _call_at  # to a type checker the typing context would be one more argument
number_at: Any = _number_at


def register_envelope(
    name: str,
    value: Scalar,
    slope: Scalar,
    inverse: Scalar,
    low: float = -math.inf,
    high: float = math.inf,
    inflection: float = math.nan,
) -> None:
    """Register f as an envelope gamma(v) = f(a v + b), increasing from `low` at -inf to `high` at +inf.

    slope: df/ds >= 0. inverse: s of a value between low and high. inflection: the one s where the slope is steepest or
    flattest; nan if the slope itself is monotone. Raises ValueError if the three contradict each other.
    """
    s = np.linspace(-4.0, 4.0, 81)
    f, g = np.array([value(float(x)) for x in s]), np.array([slope(float(x)) for x in s])
    if np.any(np.diff(f) < 0.0) or np.any(g < 0.0):
        raise ValueError(f"envelope {name!r}: value decreases, or slope is negative, between s = -4 and 4")
    _check_derivative(f"envelope {name!r}: slope", value, slope)
    inside = (f > low) & (f < high) & (g > 1e-6)
    back = np.array([inverse(float(y)) for y in f[inside]])
    if np.any(np.abs(back - s[inside]) > 1e-6):
        raise ValueError(f"envelope {name!r}: inverse(value(s)) is not s")
    _envelopes[name] = _table(value, slope, inverse, low, high, inflection)


def register_memoryless(name: str, value: Scalar, slope: Scalar, curvature: Scalar) -> None:
    """Register f as a memoryless function D(v) = amplitude f(a v + b) + offset; slope f', curvature f''.

    Turns and bends of D are found on a grid over the temperature limits (`compensator.inverse.branch`): the inverse's
    guarantee holds for features wider than that grid. Raises ValueError if the three contradict each other.
    """
    _check_derivative(f"memoryless function {name!r}: slope", value, slope)
    _check_derivative(f"memoryless function {name!r}: curvature", slope, curvature)
    _memoryless[name] = _table(value, slope, curvature, math.nan, math.nan, math.nan)


def envelope_code(name: str) -> int | None:
    """Return the code of a registered envelope function, None if there is none of this name."""
    return _envelopes.get(name)


def memoryless_code(name: str) -> int | None:
    """Return the code of a registered memoryless function, None if there is none of this name."""
    return _memoryless.get(name)


def registered() -> tuple[list[str], list[str]]:
    """Return the names of the registered envelope and memoryless functions."""
    return sorted(_envelopes), sorted(_memoryless)


def _check_derivative(what: str, value: Scalar, slope: Scalar) -> None:
    for s in np.linspace(-1.7, 1.7, 9):
        h = 1e-5
        expected = (value(float(s) + h) - value(float(s) - h)) / (2.0 * h)
        if not abs(slope(float(s)) - expected) <= 1e-4 * (1.0 + abs(expected)):
            raise ValueError(f"{what} at s = {s:g} is {slope(float(s))!r}, the difference quotient {expected!r}")


def _address(function: Scalar) -> int:
    """Return the address of the function's machine code; of a call back into Python if it cannot be compiled."""
    try:
        compiled = cfunc("float64(float64)")(function)
    except (NumbaError, NotImplementedError):
        callback = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(function)
        _kept.append(callback)
        return int(ctypes.cast(callback, ctypes.c_void_p).value or 0)
    _kept.append(compiled)
    return int(compiled.address or 0)


def _table(value: Scalar, slope: Scalar, third: Scalar, low: float, high: float, inflection: float) -> int:
    table: NDArray[np.int64] = np.empty(6, dtype=np.int64)
    for place, function in ((VALUE, value), (SLOPE, slope), (THIRD, third)):
        table[place] = _address(function)
    table.view(np.float64)[LOW:] = low, high, inflection
    _kept.append(table)
    address = int(table.ctypes.data)
    if not BUILT_IN_CODES < address < 2**53:  # an envelope's code stands in a row of float64
        raise OSError(f"address {address:#x} of a function's table does not fit a float64")
    return address
