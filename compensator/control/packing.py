"""Named tuples of numbers as one array, and back: a compiled loop takes an array in a tenth of the time of the tuple.

A tuple whose fields are floats, or such tuples, is the same memory as an array of its numbers in order. `flattener` and
`rebuilder` are for Python, `packed` and `unpacked` for compiled loops; all go by the tuple's own fields, so that a
state is spelled once.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast, get_type_hints

import numpy as np
from numba import types
from numba.extending import intrinsic

from compensator.compiled import njit
from compensator.hysteresis.functions import Array

Numbers = TypeVar("Numbers")


@cache
def fields_of(kind: type) -> dict[str, type]:
    """Return the fields of a named tuple that are numbers: floats, and named tuples of such."""
    hints = get_type_hints(kind)
    return {name: hints[name] for name in kind._fields if _is_number(hints[name])}  # type: ignore[attr-defined]


def _is_number(kind: Any) -> bool:
    return kind is float or (isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"))


def numbers_of(kind: type, name: str, module: str) -> Any:
    """Return a named tuple of those fields of another that are numbers."""
    made = namedtuple(name, fields_of(kind), module=module)  # type: ignore[misc]
    made.__annotations__ = dict(fields_of(kind))
    made.__doc__ = f"The numbers of `{kind.__name__}`, in its order."
    return made


@cache
def flattener(kind: type) -> Callable[[Any], tuple[float, ...]]:
    """Return a function that takes all numbers out of a tuple of that kind, in order.

    It is one expression, made of the fields as `namedtuple` makes a class: a walk through them takes four times as
    long.
    """

    def taken(one: type, place: str) -> list[str]:
        each = [(f"{place}.{name}", inside) for name, inside in fields_of(one).items()]
        return [t for at, inside in each for t in ([at] if inside is float else taken(inside, at))]

    made: Callable[[Any], tuple[float, ...]] = eval(f"lambda whole: ({', '.join(taken(kind, 'whole'))},)")
    return made


@cache
def rebuilder(kind: type) -> Callable[..., Any]:
    """Return a function that makes a tuple of that kind of a list of its numbers, and of its other fields."""
    names: dict[str, Any] = {"new": tuple.__new__}
    others: list[str] = []

    def made(one: type, first: int) -> tuple[str, int]:
        parts, numbers, names[one.__name__] = [], fields_of(one), one
        for name in one._fields:  # type: ignore[attr-defined]
            if name not in numbers:
                part, others[len(others) :] = name, [name]
            elif numbers[name] is float:
                part, first = f"v[{first}]", first + 1
            else:
                part, first = made(numbers[name], first)
            parts.append(part)
        return f"new({one.__name__}, ({', '.join(parts)},))", first

    body, _ = made(kind, 0)
    rebuilt: Callable[..., Any] = eval(f"lambda {', '.join(['v', *others])}: {body}", names)
    return rebuilt


def _compiled_type(kind: type) -> Any:
    """Return numba's type of such a tuple."""
    inside = [types.float64 if each is float else _compiled_type(each) for each in fields_of(kind).values()]
    if all(each == inside[0] for each in inside):
        return types.NamedUniTuple(inside[0], len(inside), kind)  # type: ignore[no-untyped-call]
    return types.NamedTuple(inside, kind)  # type: ignore[no-untyped-call]


@intrinsic
def _load(typingctx: Any, array: Any, kind: Any) -> Any:
    """See `unpacked`."""
    whole = _compiled_type(kind.instance_class)

    def load(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.load(builder.bitcast(data, context.get_value_type(whole).as_pointer()))

    return whole(array, kind), load


unpacked: Callable[[Array, type[Numbers]], Numbers] = cast(Any, _load)
"""The tuple of that kind (the class itself) that an array has the numbers of; for compiled loops."""


@intrinsic
def _store(typingctx: Any, numbers: Any, array: Any) -> Any:
    def store(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, arguments[1]).data
        builder.store(arguments[0], builder.bitcast(data, context.get_value_type(numbers).as_pointer()))
        return context.get_dummy_value()

    return types.void(numbers, array), store


stored: Callable[[Any, Array], None] = cast(Any, _store)
"""A tuple's numbers into an array that has room for them, a row of another as well; for compiled loops."""


@njit
def packed(numbers: Any, count: int) -> Array:
    """Return a tuple's count numbers in a new array; for compiled loops."""
    array = np.empty(count)
    stored(numbers, array)
    return array
