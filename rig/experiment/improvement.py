"""A run to improve: what is refused, whether an extended model predicts it better, and what a second run gains.

The limits of the second run may not be wider than the first one's, under which it went well; the law has to be one that
makes use of a model's effects. The gain compares the errors of both runs over the whole target
(`rig.analysis.error`); its interval comes from blocks of the target drawn with replacement, as that of a diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.error import TargetError
from rig.analysis.prediction import ChannelError, errors_of, predicted
from rig.config.configuration import ConfigurationFile, read_configuration
from rig.config.model_file import Drive, read_model
from rig.config.target import Target, read_target
from rig.control.law_units import COMPENSATED
from rig.core.faults import Faults
from rig.experiment.feasibility import KINDS, TRACKING, quantity_of, target_of
from rig.records.film_output import FALLING_RESISTANCE
from rig.records.record_file import Record
from rig.records.run_folder import LAW, RunRows, ended_early, recorded_run
from sim.effects.catalogue import catalogue
from sim.inference.gain import gain

SAME = 1e-6  # of a target's values: what their writing as resistances and back may change
FEWEST = 60  # rows that both runs have, one for each block
WORTH: Final = 0.1  # less error, by a fit alone: one of 50 numbers to 2,500 rows of noise gains 0.01 by itself
TEMPERATURE: Final = "temperature_degC"
BOTH: Final[tuple[Drive, Drive]] = ("temperature", "current")
NO_WIDER = ("current_A", "meter_current_A")


@dataclass(frozen=True)
class Gain:
    """Gain of a second run. reduction: 1 - RMS of the second over RMS of the first; ci95: its 95 % interval."""

    reduction: float
    ci95: tuple[float, float]

    @property
    def in_words(self) -> str:
        """The gain in words."""
        low, high = (100.0 * value for value in self.ci95)
        if low > 0.0:
            return f"{100.0 * self.reduction:.0f} % less ({low:.0f} to {high:.0f} %)"
        if high < 0.0:
            return f"{-100.0 * self.reduction:.0f} % more ({-high:.0f} to {-low:.0f} %): nothing is gained"
        return f"no difference that shows ({low:.0f} to {high:.0f} % less)"


def same_target(one: Target, other: Target) -> bool:
    """Return True if two runs followed the same course."""
    if one.quantity != other.quantity or one.times_s.shape != other.times_s.shape:
        return False
    return bool(
        np.allclose(one.times_s, other.times_s, rtol=SAME, atol=SAME)
        and np.allclose(one.values, other.values, rtol=SAME, atol=SAME)
    )


def gain_of(first: TargetError | None, second: TargetError | None) -> Gain | None:
    """Return the gain of a second run over the first; None if one has no error, or they are too short for an
    interval."""
    if first is None or second is None or first.unit != second.unit or second.time_s.size < FEWEST:
        return None
    before, after = first.error, _at_the_rows_of(first, second)
    both = np.isfinite(before) & np.isfinite(after)
    if int(np.sum(both)) < FEWEST:
        return None
    found = gain(before, after, both)
    return Gain(1.0 - found.rmse_after / found.rmse_before, found.reduction_ci95)


def _at_the_rows_of(first: TargetError, second: TargetError) -> Array:
    """Return the second run's errors at the times of the first's rows: a tick that one of them missed is nan, and
    shifts no other row."""
    times = second.time_s
    after = np.clip(np.searchsorted(times, first.time_s), 1, times.size - 1)
    nearest = np.where(first.time_s - times[after - 1] < times[after] - first.time_s, after - 1, after)
    near = np.abs(times[nearest] - first.time_s) <= 0.5 * float(np.median(np.diff(times)))
    return np.where(near, second.error[nearest], np.nan)


def news(effects: Sequence[Mapping[str, Any]], known: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the named effects (as a diagnosis' JSON has them) that a model does not have, or has at a value that the
    record rejects. The model's own estimate may be as far off as the one found, so the value is compared with an
    interval twice as wide."""
    has = {str(table["name"]): table for table in known}
    return [str(e["name"]) for e in effects if not _has(has.get(str(e["name"])), e["parameters"])]


def as_effects(candidate: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the effects of a candidate, each as one that is named."""
    return [{"name": name, "parameters": candidate["parameters"][name]} for name in candidate["names"]]


def _has(table: Mapping[str, Any] | None, parameters: Mapping[str, Any]) -> bool:
    if table is None:
        return False
    for name, found in parameters.items():
        if found["ci95"] is not None:
            low, high = found["ci95"]
            if abs(float(table[name]) - 0.5 * (low + high)) > high - low:
                return False
    return True


def no_better(extended: Path, own: Path, record: Record, followed: str, new: Iterable[str]) -> str | None:
    """Return why the extended model is of no use, in words; None if it predicts the record better than the run's own,
    or they cannot be compared. Raises Faults for a model that cannot be read.

    followed: what the run followed: the film's output, or "temperature_degC". new: effects that the run's own does not
    have, or has at another size. Those before the film have to predict the temperature better, any other one the film.
    If both models have the same effects, `fitted_no_better` decides. The record's own state is fitted to its first
    rows.
    """
    if names_of(read_model(extended).effects) == names_of(read_model(own).effects):
        return fitted_no_better(extended, own, record, followed)
    known = catalogue()
    before_film = all(name in known and known[name].before_film for name in new)
    after, before = _errors(extended, own, record, TEMPERATURE if before_film else followed)
    if after is None or before is None or after.rmse < before.rmse:
        return None
    return f"with the extended model {after.what} of the run's own record is predicted {_in_words(after, before)}"


def fitted_no_better(extended: Path, own: Path, record: Record, followed: str) -> str | None:
    """Return why a model with the effects of the run's own, maybe at other sizes, is of no use; None if it is.

    Its film and plate are fitted to the run, those of the run's own to a calibration. It is of use if it predicts what
    was followed better by more than `WORTH`, at the lower end of the gain's interval. Raises Faults for a model that
    cannot be read.
    """
    after, before = _errors(extended, own, record, followed)
    if after is None or before is None:
        return f"{followed} of the run's own record cannot be predicted by both models"
    if _less(before, after) > WORTH:
        return None
    return f"with film and plate fitted to the run {after.what} of its record is predicted {_in_words(after, before)}"


def names_of(effects: Iterable[Mapping[str, Any]]) -> set[str]:
    """Return the names of effects as a model file, or a diagnosis, has them."""
    return {str(effect["name"]) for effect in effects}


def _errors(extended: Path, own: Path, record: Record, channel: str) -> tuple[ChannelError | None, ChannelError | None]:
    return _error(extended, record, channel), _error(own, record, channel)


def _in_words(after: ChannelError, before: ChannelError) -> str:
    return f"to {after.rmse:.2g} {after.unit}, with the one that the run had to {before.rmse:.2g} {after.unit}"


def _less(before: ChannelError, after: ChannelError) -> float:
    """Return the share by which the error is less: the lower end of the 95 % interval."""
    first, second = (one.predicted - one.measured for one in (before, after))
    both = np.isfinite(first) & np.isfinite(second)
    return gain(first, second, both).reduction_ci95[0] if bool(np.any(both)) else 0.0


def _error(path: Path, record: Record, channel: str) -> ChannelError | None:
    """Return the error of a channel. A film is predicted from the thermometer or the current, whichever is better: with
    effects a model would use the current alone, without them the thermometer."""
    model = read_model(path)
    if channel == TEMPERATURE:  # the film has no part in it, and may not have been read
        model = replace(model, film=None)
    found = [
        error
        for drive in (BOTH[:1] if channel == TEMPERATURE else BOTH)
        for error in errors_of(predicted(model, record, path, initial="fitted", drive=drive), model, record)
        if error.name == channel
    ]
    return min(found, key=lambda error: error.rmse, default=None)


@dataclass(frozen=True)
class Improvable:
    """A run and the configuration of the second one. output: of the film. known: the effects of the run's model. law:
    of the second run. comparable: True if both runs follow one target with one law; caveats: why not, and what else
    differs.
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
        """Return True if one of these effects acts before the quantity that is followed."""
        if self.kind in TRACKING:
            return bool(names)
        known = catalogue()
        return any(name in known and known[name].before_film for name in names)

    def why_not(self, effects: Sequence[Mapping[str, Any]], new: Sequence[str], tried: Sequence[str]) -> str | None:
        """Return why a second run is of no use, None if it may be. effects: that are named; new: those of them that the
        model does not have; tried: found and not named."""
        if new or tried:
            if self.helped_by(new or tried):
                return None
            what, names = "named" if new else "found", ", ".join(new or tried)
            return f"no effect that is {what} ({names}) acts on what kind {self.kind!r} follows"
        return None if effects else "no effect is named in this record"

    def no_better(
        self, extended: Path, record: Record, effects: Sequence[Mapping[str, Any]], new: Sequence[str]
    ) -> str | None:
        """Return why an extended model with these effects is of no use, None if it may be run: it has to predict the
        run better than the run's own. new: of the effects those that the run's own does not have, or has at another
        size."""
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
    """Read and check both. Raises Faults."""
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
    """Yield a line if a second run could gain nothing."""
    e = file.content.experiment
    if KINDS[e.kind].policy is not None:
        text = f"{e.kind!r} follows no target by a law; expected track_resistance, temperature_profile or hold"
        yield f"{file.path}: experiment.kind: {text}"
    elif e.law == "instrument_pid" or (e.kind in TRACKING and e.law not in COMPENSATED):
        yield f"{file.path}: experiment.law: {e.law!r} makes no use of a model's effects; expected full or feedforward"


def _wider(file: ConfigurationFile, run: RunRows) -> Iterator[str]:
    """Yield a line for each limit that is wider than the run's."""
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
    """Yield why the errors of both runs cannot be compared."""
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
    """Return the film's output, as the run read it."""
    meter = run.document["start"]["settings"].get("bench", {}).get("meter") or {}
    if isinstance(meter.get("output"), str):
        return str(meter["output"])
    path = run.part / "model.toml"
    film = read_model(path).film if path.is_file() else None
    return film.output if film is not None else FALLING_RESISTANCE


def _known(run: RunRows) -> Sequence[Mapping[str, Any]]:
    """Return the effects of the model that the run used; only a run that came to its end has kept it."""
    path = run.part / "model.toml"
    return read_model(path).effects if path.is_file() else ()
