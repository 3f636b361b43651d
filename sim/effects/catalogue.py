"""The effects that there are: every module of this folder with an `EFFECT`, and those of a user's own."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from importlib.machinery import ModuleSpec
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import sim.effects
from sim.effects.effect import LINKS, Effect

_own: dict[str, Effect] = {}


def catalogue() -> dict[str, Effect]:
    """Return all effects by name, along the signal chain."""
    found = dict(_own)
    for module in pkgutil.iter_modules(sim.effects.__path__):
        effect = getattr(importlib.import_module(f"sim.effects.{module.name}"), "EFFECT", None)
        if isinstance(effect, Effect):
            found[effect.name] = effect
    return dict(sorted(found.items(), key=lambda item: (LINKS.index(item[1].link), item[1].order, item[0])))


def add_effect_file(path: Path) -> Effect:
    """Make an effect of a user's own known: a Python file with an `EFFECT`. Raises ValueError."""
    spec: ModuleSpec | None = spec_from_file_location(f"own_effect_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path}: expected a Python file")
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise ValueError(f"{path}: EFFECT: missing; expected an Effect of sim.effects.effect")
    add_effect(effect)
    return effect


def add_effect(effect: Effect) -> None:
    """Make an effect known to simulator and diagnosis under its name. Raises ValueError."""
    if len(effect.parameters) < 1 or any(not p.smallest > 0.0 or not p.largest > p.smallest for p in effect.parameters):
        raise ValueError(f"{effect.name}: parameters: expected at least one, each with 0 < smallest < largest")
    _own[effect.name] = effect
