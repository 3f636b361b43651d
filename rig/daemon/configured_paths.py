"""Where a bench's configuration has its history and its film's model."""

from __future__ import annotations

from pathlib import Path

from rig.config.configuration import ConfigurationFile


def history_folder(file: ConfigurationFile) -> Path:
    """Where run folders and the history are: serve.folder beside the configuration, else runs/ where it was started."""
    folder = file.content.serve.folder
    return file.beside(folder) if folder is not None else Path("runs").absolute()


def model_of(file: ConfigurationFile) -> Path | None:
    """The film's model that a configuration names."""
    name = file.content.experiment.model
    return file.beside(name).absolute() if name is not None else None
