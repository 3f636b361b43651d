"""A formula of one voltage, as a configuration gives it: numbers, voltage_V, + - * / **, parentheses, log10, exp, sqrt.

    (voltage_V - 0.131) * 22.4
    10 ** ((voltage_V - 1.2) / 0.35)

The text is taken apart by Python's own parser and put together again from the pieces that are allowed here; nothing in
it is ever run. What has no value (a division by zero, the logarithm of nothing) is nan, not an error.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass

NAME = "voltage_V"
LONGEST = 200  # characters
FUNCTIONS: dict[str, Callable[[float], float]] = {"log10": math.log10, "exp": math.exp, "sqrt": math.sqrt}
OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
}
ALLOWED = f"numbers, {NAME}, + - * / **, parentheses, {', '.join(FUNCTIONS)}"
Value = Callable[[float], float]


@dataclass(frozen=True)
class Formula:
    """What a voltage stands for. Build it with `formula`."""

    text: str
    value: Value

    def __call__(self, voltage_V: float) -> float:
        """The quantity at a voltage, V; nan where there is none."""
        try:
            found = self.value(voltage_V)
        except (ArithmeticError, ValueError):
            return math.nan
        return found if math.isfinite(found) else math.nan


def formula(text: str) -> Formula:
    """The formula that `text` says. ValueError where it says something else."""
    if len(text) > LONGEST:
        raise ValueError(f"a formula of {len(text)} characters: at most {LONGEST} are expected")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"formula {text!r} cannot be read; expected {ALLOWED}") from None
    value = _value(tree.body)
    if not any(isinstance(node, ast.Name) and node.id == NAME for node in ast.walk(tree)):
        raise ValueError(f"formula {text!r} does not depend on {NAME}")
    return Formula(text.strip(), value)


def _value(node: ast.expr) -> Value:
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        constant = float(node.value)  # type: ignore[arg-type]
        return lambda _: constant
    if isinstance(node, ast.Name) and node.id == NAME:
        return lambda voltage_V: voltage_V
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.UAdd, ast.USub)):
        inner, sign = _value(node.operand), -1.0 if isinstance(node.op, ast.USub) else 1.0
        return lambda voltage_V: sign * inner(voltage_V)
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        left, right, combine = _value(node.left), _value(node.right), OPERATORS[type(node.op)]
        return lambda voltage_V: combine(left(voltage_V), right(voltage_V))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) == 1 and not node.keywords:
        argument, function = _value(node.args[0]), FUNCTIONS.get(node.func.id)
        if function is not None:
            return lambda voltage_V: function(argument(voltage_V))
    raise ValueError(f"formula: {ast.unparse(node)!r} is not allowed; expected {ALLOWED}")
