"""A run that shall be improved, beside the configuration that shall run again: what is refused, what is comparable.

The limits may not be wider than the run's, since it was under those that it went well; the law has to be one that
makes use of a model's effects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.analysis.gained import same_target
from rig.analysis.no_better import names_of, no_better
from rig.config.configuration import ConfigurationFile, read_configuration
from rig.config.model_file import read_model
from rig.config.target import read_target
from rig.core.faults import Faults
from rig.experiment.extended_model import COMPENSATED
from rig.experiment.wanted import TRACKING, quantity_of, target_of
from rig.records.film_output import FALLING_RESISTANCE
from rig.records.record_file import Record
from rig.report.run_rows import LAW, RunRows, ended_early, recorded_run
from sim.effects.catalogue import catalogue

NO_WIDER = ("current_A", "meter_current_A")


@dataclass(frozen=True)
class Improvable:
    """run, file: as read. output: of the film. known: the effects of the run's model. law: of the second run.

    comparable: whether both runs follow one target with one law; caveats: why not, and what else differs.
    """

    run: RunRows
    file: ConfigurationFile
    output: str
    known: Sequence[Mapping[str, Any]]
    law: str
    comparable: bool
    caveats: tuple[str, ...]

    @property
    def kind(self) -> str:
        return self.file.content.experiment.kind

    def helped_by(self, names: Sequence[str]) -> bool:
        """Whether one of these effects acts before the quantity that is followed."""
        if self.kind in TRACKING:
            return bool(names)
        known = catalogue()
        return any(name in known and known[name].before_film for name in names)

    def why_not(self, effects: Sequence[Mapping[str, Any]], new: Sequence[str], tried: Sequence[str]) -> str | None:
        """Why there is nothing to run again for, None where there is. effects: that are named; new, tried: of those the
        new ones, and what is found and not named."""
        if new or tried:
            if self.helped_by(new or tried):
                return None
            what, names = "named" if new else "found", ", ".join(new or tried)
            return f"no effect that is {what} ({names}) acts on what kind {self.kind!r} follows"
        return None if effects else "no effect is named in this record"

    def no_better(
        self, extended: Path, record: Record, effects: Sequence[Mapping[str, Any]], new: Sequence[str]
    ) -> str | None:
        """Why nothing is to be expected of an extended model with these effects, None where it may be run: it has to
        tell the run better than the run's own. new: of the effects those that the run's own does not have, or has at
        another size."""
        own = self.run.part / "model.toml"
        if not own.is_file():
            return None
        followed = self.output if self.kind in TRACKING else "temperature_degC"
        named = ", ".join(sorted(names_of(effects)))
        had = f"the run's model already has what is named ({named}), at sizes that the record bears out"
        if not new and names_of(effects) != names_of(self.known):  # fewer than it has
            return had
        found = no_better(extended, own, record, followed, new)
        return found if new or found is None else f"{had}, and {found}"


def improvable(run_folder: Path, config: Path) -> Improvable:
    """Both read and checked. Raises Faults, a line each."""
    run, file = recorded_run(run_folder), read_configuration(config)
    lines = [*_unusable(file), *_wider(file, run)]
    if lines:
        raise Faults(lines)
    law = file.content.experiment.law if file.content.experiment.kind in TRACKING else "temperature"
    caveats = list(_incomparable(run, file, law))
    comparable = not caveats
    if ended_early(run):
        caveats.append("the first run did not come to its end")
    return Improvable(run, file, _output(run), _known(run), law, comparable, tuple(caveats))


def _unusable(file: ConfigurationFile) -> Iterator[str]:
    """A line where a second run could gain nothing."""
    e = file.content.experiment
    if e.kind == "current_profile":
        text = "'current_profile' follows no target; expected track_resistance, temperature_profile or hold"
        yield f"{file.path}: experiment.kind: {text}"
    elif e.law == "instrument_pid" or (e.kind in TRACKING and e.law not in COMPENSATED):
        yield f"{file.path}: experiment.law: {e.law!r} makes no use of a model's effects; expected full or feedforward"


def _wider(file: ConfigurationFile, run: RunRows) -> Iterator[str]:
    """A line for each limit that is wider than the run's."""
    now, where = file.content.limits, run.part / "run.json"
    then = run.document["start"]["settings"].get("limits")
    if not isinstance(then, dict):
        yield f"{where}: start.settings.limits: missing; expected the limits of the run"
        return
    for name in NO_WIDER:
        if isinstance(then.get(name), (int, float)) and getattr(now, name) > then[name]:
            yield f"{file.path}: limits.{name}: {getattr(now, name):g}: expected at most the run's, {then[name]:g}"
    low, high = now.temperature_degC
    span = then.get("temperature_degC")
    if isinstance(span, list) and len(span) == 2 and not (span[0] <= low and high <= span[1]):
        yield f"{file.path}: limits.temperature_degC: {[low, high]}: expected within the run's, {span}"


def _incomparable(run: RunRows, file: ConfigurationFile, law: str) -> Iterator[str]:
    """Why the errors of both runs say nothing of the model."""
    path, what = run.part / "target.csv", str(run.document["start"]["what"])
    quantity = quantity_of(file.content)
    then = what.removeprefix(LAW) if what.startswith(LAW) else "temperature"
    if not path.is_file():
        yield "the first run has no target: its error cannot be compared"
    elif what.startswith(LAW) != (file.content.experiment.kind in TRACKING) or not same_target(
        read_target(path, quantity), target_of(file)
    ):
        yield "the first run had another target: the errors cannot be compared"
    elif then != law:
        yield f"the first run had the law {then!r}, the second {law!r}: the errors cannot be compared"


def _output(run: RunRows) -> str:
    """Of the film, as the run read it."""
    meter = run.document["start"]["settings"].get("bench", {}).get("meter") or {}
    if isinstance(meter.get("output"), str):
        return str(meter["output"])
    path = run.part / "model.toml"
    film = read_model(path).film if path.is_file() else None
    return film.output if film is not None else FALLING_RESISTANCE


def _known(run: RunRows) -> Sequence[Mapping[str, Any]]:
    """The effects of the model that the run used: it keeps that beside its rows when it has come to its end."""
    path = run.part / "model.toml"
    return read_model(path).effects if path.is_file() else ()
