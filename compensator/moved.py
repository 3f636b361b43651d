"""Modules that have moved are found under their former names for one more release, with a warning that users see.

moved("compensator", {"film": "hysteresis.film"})     # in the package's __init__: compensator.film is still found
__getattr__ = names_of("compensator.inverse.inverse") # where a package stands now under the name of a module
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


class _Moved:
    """Finds and loads former names; the import system asks it after all others."""

    def __init__(self, places: Mapping[str, str]) -> None:
        self._places = places

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(name, self) if name in self._places else None  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> None:
        """An empty module, as the import system makes it."""

    def exec_module(self, module: ModuleType) -> None:
        """The names of the module as it is now, the same objects."""
        now = self._places[module.__name__]
        _warn(f"{module.__name__} is now {now}")
        held = {name: value for name, value in vars(import_module(now)).items() if not name.startswith("__")}
        vars(module).update(held)


def moved(package: str, places: Mapping[str, str]) -> None:
    """Former module -> where it is now, both below the package."""
    sys.meta_path.append(_Moved({f"{package}.{old}": f"{package}.{new}" for old, new in places.items()}))


def names_of(module: str) -> Callable[[str], Any]:
    """A package's `__getattr__`: what was in the module of the package's name is in this one."""

    def found(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = getattr(import_module(module), name)
        _warn(f"{module.rpartition('.')[0]}.{name} is now in {module}")
        return value

    return found


def _warn(text: str) -> None:
    """A FutureWarning: a DeprecationWarning is shown to the authors of a program, not to those who use it."""
    warnings.warn(f"{text}; the former name goes with the next release", FutureWarning, stacklevel=3)
