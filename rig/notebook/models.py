"""Models for a notebook: a file's, or those that an identification or a diagnosis has found."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

from rig.config.model_file import Model
from rig.config.model_file import read_model as read_file
from rig.config.model_file import write_model as write_file
from rig.core.faults import fault


def read_model(path: str | PathLike[str]) -> Model:
    """The film, plate and effects of a model file (TOML), as `peltier identify --out` writes it. Raises Faults."""
    return read_file(Path(path))


def write_model(path: str | PathLike[str], model: Any, comment: str = "") -> None:
    """Write a model file for `peltier run`, `predict` and `invert`. model: a Model, an identification or a diagnosis;
    comment: lines for its head. Raises Faults, OSError."""
    write_file(Path(path), as_model(model)[0], comment)


def as_model(source: Any) -> tuple[Model, str]:
    """A model, and what messages call it: of a Model, of what has found one, or of a file. Raises Faults."""
    if isinstance(source, Model):
        return source, "model"
    held = getattr(source, "model", None)
    if isinstance(held, Model):
        return held, "model"
    if isinstance(source, (str, PathLike)):
        return read_model(source), str(source)
    text = f"expected a Model, what identify or diagnose has found, or a file's path, not {type(source).__name__}"
    raise fault("model", "", text)
