"""A law again over a recorded run: the same readings in, its commands compared with those that were sent."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from rig.analysis.error import tracked
from rig.config.configuration import ConfigurationFile, configuration_of
from rig.config.model_file import plate_table, read_model
from rig.config.target import read_target
from rig.config.toml_file import read_text, read_toml, shown
from rig.control.decision import Policy, Predicts, law_of, read_at
from rig.control.law_units import known_plate, plate_observer
from rig.control.loop import Loop
from rig.control.policies import Follow
from rig.core.faults import fault
from rig.core.json_text import parsed_json
from rig.experiment.feasibility import TRACKING, quantity_of
from rig.experiment.repetitions import USED, read_correction
from rig.experiment.simulation import simulated_configuration, table_in
from rig.experiment.tracking import law_and_design, plan_tracking, to_temperature, track
from rig.records.record_file import Record, read_record
from rig.records.run_folder import LAW, LAWS, software_versions
from rig.safety.plate_watch import watchable_rate_K_per_s

MADE_BY = ("peltier-rig", "sources", "python", "numpy", "numba")  # what a command's bits depend on
READ = (  # of each row
    *("time_s", "temperature_degC", "resistance_time_s", "current_time_s", "acts_after_s", "tick"),
    *("meter_current_A", "current_A", "setpoint_degC"),
)
FILES = ("config.toml", "record.csv", "model.toml", "target.csv", "run.json", "events.jsonl")


@dataclass
class Replay:
    """Counts of commands compared and different, and the largest difference (A, or K for setpoints).

    other_versions: software of another version than made the run, (then, now) by name; the bits may differ then.
    """

    compared: int = 0
    different: int = 0
    largest: float = 0.0
    first_different_s: float | None = None
    other_versions: dict[str, tuple[str, str]] = field(default_factory=dict)


@dataclass
class RecordedLoop:
    """A stand-in for a loop, out of a record: each phase gives the policy its rows once more."""

    record: Record
    phases: list[dict[str, Any]]
    replay: Replay = field(default_factory=Replay)

    def __post_init__(self) -> None:
        self._row = 0
        what = tracked(self)
        self.outputs = self.column(what.measured)
        if what.in_ohm:
            good = np.isfinite(self.outputs) & (self.outputs > 0.0)
            known = zip(self.outputs, good, strict=True)
            self.outputs = np.array([-math.log10(ohm) if ok else math.nan for ohm, ok in known])
        self.folder = self
        self.limits = SimpleNamespace(stale_s=math.inf)

    @property
    def columns(self) -> Iterable[str]:
        """Names of the columns."""
        return self.record.columns

    def column(self, name: str) -> Any:
        """Return a column of the record. Raises Faults if it is missing."""
        if name in self.record.text_columns:
            return np.array(self.record.text_columns[name])
        if name not in self.record.columns:
            raise fault(self.record.source, name, "missing; expected the column of a run's record")
        return self.record[name]

    def phase(self, name: str, policy: Policy, duration_s: float, period_s: float) -> None:
        """Give the policy the rows of the next phase of this name, as far as they were recorded."""
        while self.phases and self.phases[0]["text"] != name:
            self.phases.pop(0)
        if not self.phases:
            return
        rows = self._rows_of_next()
        begin = self.phases.pop(0)["time_s"]
        for row in rows:
            at = {name: float(self.record[name][row]) for name in READ}
            tick_s = int(at["tick"]) * period_s
            read_s = at["time_s"], at["resistance_time_s"], at["acts_after_s"]
            read = read_at(begin, tick_s, *read_s, at["meter_current_A"])
            decision = policy.decide(tick_s, at["temperature_degC"], float(self.outputs[row]), read)
            if decision.done or decision.wait:
                continue
            acknowledged = not math.isnan(at["current_time_s"])
            if isinstance(policy, Predicts):
                if acknowledged:
                    policy.acted(at["current_time_s"] - begin)
                else:
                    policy.held(at["current_A"])
            if acknowledged:
                sent = "setpoint_degC" if decision.use_setpoint else "current_A"
                self._compare(getattr(decision, sent), at[sent], at["time_s"])

    def _rows_of_next(self) -> Any:
        """Return the rows of the next phase: from its beginning on those of its name, as long as their ticks go on."""
        time, begin = self.record["time_s"], self.phases[0]["time_s"]
        names, ticks = self.record.text_columns["phase"], self.record["tick"]
        first = self._row
        while first < time.size and (names[first] != self.phases[0]["text"] or time[first] < begin):
            first += 1
        last = first
        while last < time.size and names[last] == names[first] and (last == first or ticks[last] > ticks[last - 1]):
            last += 1
        self._row = last
        return np.arange(first, last)

    def _compare(self, now: float, then: float, time_s: float) -> None:
        replay = self.replay
        replay.compared += 1
        if now != then and not (math.isnan(now) and math.isnan(then)):
            replay.different += 1
            replay.largest = max(replay.largest, abs(now - then))
            if replay.first_different_s is None:
                replay.first_different_s = time_s


def replay_run(folder: Path) -> Replay:
    """Compare the commands of a run's law with its record. Raises Faults if the folder is not of such a run."""
    own = _own_phases(folder)
    if own:
        return _replay_own(folder, own)
    for name in FILES:
        if not (folder / name).is_file():
            raise fault(folder / name, "", "no such file; expected the folder of a run with a target and a model")
    file = _configuration(folder)
    e = file.content.experiment
    model = read_model(folder / "model.toml", needs=("plate",))
    assert model.plate is not None
    target = read_target(folder / "target.csv", quantity_of(file.content))
    loop = RecordedLoop(_record(folder / "record.csv"), _phases(folder / "events.jsonl"))
    stand_in = cast(Loop, loop)
    fastest = watchable_rate_K_per_s(known_plate(model.plate, model.switched()))
    if e.kind in TRACKING:
        if model.film is None:
            raise fault(folder / "model.toml", "film", "missing")
        plan = plan_tracking(file.content, target, model, _law(folder / "run.json"), fastest)
        if (folder / USED).is_file():
            plan = replace(plan, model_lacks=read_correction(folder / USED))
        track(stand_in, file.content, plan)
    elif e.kind in ("temperature_profile", "hold") and e.law != "instrument_pid":
        observer = plate_observer(model.switched(), model.plate, e.period_s)
        law, _ = law_and_design("temperature", file.content, cast(Any, model.film), model.plate, observer, fastest)
        policy = Follow(law, target)
        start = to_temperature(stand_in, law, None, float(target.values[0]), e.settle_s, "approach", False)
        policy.state = start.state
        loop.phase("profile", policy, target.duration_s, e.period_s)
    else:
        raise fault(folder / "config.toml", "experiment.kind", f"{e.kind!r} with this law has no command of ours")
    loop.replay.other_versions = _other_versions(folder / "run.json")
    return loop.replay


def _own_phases(folder: Path) -> list[dict[str, Any]]:
    """Return the phases of user-defined laws; none of a folder without events. Raises Faults."""
    events = folder / "events.jsonl"
    return [phase for phase in _phases(events) if {"law", "not_kept"} & phase.keys()] if events.is_file() else []


def _replay_own(folder: Path, own: list[dict[str, Any]]) -> Replay:
    """Compare the commands of user-defined laws with their run's record. Raises Faults."""
    for phase in own:
        if "law" not in phase:
            text = f"phase {phase['text']!r}: its law is not in the run folder: {phase['not_kept']}"
            raise fault(folder / "events.jsonl", "", text)
    loop = RecordedLoop(_record(folder / "record.csv"), _phases(folder / "events.jsonl"))
    for phase in own:
        loop.phases = [one for one in loop.phases if one["time_s"] >= phase["time_s"]]
        loop.phase(phase["text"], law_of(folder, phase), float(phase["duration_s"]), float(phase["period_s"]))
    loop.replay.other_versions = _other_versions(folder / "run.json")
    return loop.replay


def _other_versions(path: Path) -> dict[str, tuple[str, str]]:
    """Return the software of another version than made the run: (then, now) by name. Raises Faults."""
    then = _start(path, "versions")
    if not isinstance(then, dict):
        raise fault(path, "start.versions", "expected the versions that made the run")
    now, unknown = software_versions(), "not recorded"
    return {name: (str(then.get(name, unknown)), now[name]) for name in MADE_BY if then.get(name) != now[name]}


def _law(path: Path) -> Any:
    """Return the name of the law that ran. Raises Faults."""
    what = str(_start(path, "what"))
    law = what.removeprefix(LAW)
    if law not in LAWS:
        raise fault(path, "start.what", f"{shown(what)}: expected 'law' and one of {', '.join(LAWS)}")
    return law


def _start(path: Path, key: str) -> Any:
    """Return a value of the start that run.json keeps. Raises Faults."""
    try:
        return parsed_json(read_text(path))["start"][key]
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise fault(path, f"start.{key}", f"expected the start of a run ({error})") from None


def _record(path: Path) -> Record:
    """Read the run's rows. Raises Faults if a column is missing that the law saw or set."""
    record = read_record(path, needs=("temperature_degC",), options=False)
    record = replace(record, columns=record.raw_columns())  # what the law saw
    for name in (*READ, "phase"):
        if name not in (*record.columns, *record.text_columns):
            raise fault(path, name, "missing; expected the column of a run's record")
    return record


def _phases(path: Path) -> list[dict[str, Any]]:
    """Return the events of all phases, in order. Raises Faults."""
    found = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        try:
            event = parsed_json(line)
            if event["event"] == "phase":
                found.append({**event, "time_s": float(event["time_s"]), "text": str(event["text"])})
        except (ValueError, TypeError, KeyError, IndexError, OverflowError):
            raise fault(path, f"line {number}", "expected an event: JSON with time_s, event and text") from None
    return found


def _configuration(folder: Path) -> ConfigurationFile:
    """Return the run's configuration, with model and target from the run's folder."""
    path = folder / "config.toml"
    raw = read_toml(path)
    table_in(raw, "experiment").update(model="model.toml", target="target.csv")
    raw.pop("simulation", None)
    return configuration_of(path, read_text(path), raw)


def twin_configuration(folder: Path, other: Path) -> ConfigurationFile:
    """Return another configuration on a run's twin, with film and plate of its model. Raises Faults."""
    where = (folder / "model.toml").resolve()
    model = read_model(where, needs=("film", "plate"))
    assert model.plate is not None
    raw = read_toml(other)
    table_in(raw, "experiment").setdefault("model", str(where))
    simulation = table_in(raw, "simulation")
    simulation |= {"film": {"kind": "model", "model": str(where)}, "plate": plate_table(model.plate)}
    simulation.pop("heat_sink_warmup", None)
    simulation.pop("effects", None)
    return simulated_configuration(other, raw, [], None)
