"""One record diagnosed, with what is reported of it and the files of its report, as values: it may be done anywhere."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from rig.analysis.diagnosed import diagnosed, model_of
from rig.analysis.earlier_records import earlier_film_records, told_by
from rig.analysis.one_row import of_diagnosis
from rig.analysis.tried import best_tried
from rig.config.effect_tables import add_effect_files, parse_assumed_effects
from rig.config.model_file import Model, write_model
from rig.core.faults import Faults
from rig.many.engine import given
from rig.records.film_output import FALLING_RESISTANCE
from rig.records.record_file import Record
from rig.report.diagnosis import write_diagnosis_report
from rig.report.diagnosis_lines import lines
from rig.report.diagnosis_records import together as records_of
from rig.report.many_records import Task
from rig.report.model_comment import model_comment, unit_lines
from rig.report.told import CANDIDATE, MODEL, Told, files_in
from sim.diagnosis.extended_model import ExtendedModel
from sim.diagnosis.result import with_model

RANK = (
    "partly_unexplained",
    "explained",
    "unexplained",
    "too_short",
    "clean",
)  # what there is to do about it, most first


@dataclass(frozen=True)
class Asked:
    """How to diagnose. base: of the film; output: as in a model file; plate: its kind, None: what the drive allows.
    effect_files: with effects of one's own, which another process has to load too; assume: NAME[:param=value,...] of
    effects that are there; budget_s: how long each record may take; false_alarm: the share of records with nothing in
    them that may be given a name, None: 1 %."""

    base: str | None = None
    output: str = FALLING_RESISTANCE
    plate: str | None = None
    effect_files: tuple[Path, ...] = ()
    assume: tuple[str, ...] = ()
    budget_s: float | None = None
    false_alarm: float | None = None


def told(
    record: Any,
    asked: Asked,
    model: str | None = None,
    *holdout: Any,
    report: bool | None = None,
    further: Sequence[Record] = (),
    say: Callable[[str], None] = lambda text: None,
) -> Told:
    """record, holdout: `Record`s, or what an engine shares of them. model: where its model will stand; None: nowhere.
    report: whether its files are wanted; None: where the model is. further: records that are diagnosed with it as one;
    say: progress."""
    _know(asked.effect_files)
    one: Record = given(record)
    before = earlier_film_records(one.source, say)
    try:
        diagnosis, extended = diagnosed(
            one,
            asked.base,
            asked.output,
            [given(other) for other in holdout],
            asked.plate,
            parse_assumed_effects(asked.assume),
            asked.budget_s,
            further,
            asked.false_alarm,
            say,
            before,
        )
    except Faults as faults:
        return Told(faults=tuple(faults.lines))
    tried = None
    reported = report if report is not None else model is not None
    if reported:
        diagnosis, tried = best_tried(diagnosis, extended, before)
    if model is not None:
        diagnosis = with_model(diagnosis, model)
    together = [one, *further]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if model is not None:
            write_model(folder / MODEL, _of_records(extended, together, before), model_comment(diagnosis))
        if reported:
            if tried is not None:
                names = ", ".join(diagnosis.candidates[0].names)
                comment = f"with what was found in {records_of(diagnosis)} and is not named: {names}"
                comment = "\n".join([comment, *unit_lines(diagnosis)])
                write_model(folder / CANDIDATE, _of_records(tried, together, before), comment)
            write_diagnosis_report(folder, diagnosis)
        files = files_in(folder)
    return Told(diagnosis.document(), tuple(lines(diagnosis)), files)


def _of_records(extended: ExtendedModel, together: Sequence[Record], before: Sequence[Record]) -> Model:
    """The model, with the records that told its film, where they are files."""
    return told_by(model_of(extended), [*together, *(before if extended.others else [])])


@lru_cache
def _know(effect_files: tuple[Path, ...]) -> None:
    """Once a process."""
    add_effect_files(effect_files)


def _rank(row: Mapping[str, Any]) -> tuple[int, float, int]:
    """What matters first: what shows an effect, by the evidence; then what nothing explains; then what is clean."""
    verdict = str(row.get("verdict", ""))
    evidence = [value for key, value in row.items() if key.endswith(".evidence") and isinstance(value, float)]
    place = RANK.index(verdict) if verdict in RANK else len(RANK)
    return place, -max(evidence, default=0.0), int(row["number"])


def diagnoses(asked: Asked, holdout: Sequence[Record]) -> Task:
    """Of many records."""
    return Task(
        work=told,
        asked=asked,
        document="diagnosis.json",
        table="diagnoses",
        title="Diagnoses",
        row=of_diagnosis,
        rank=_rank,
        columns={"verdict": "verdict", "named": "effects and sizes", "left": "left over"},
        shared=tuple(holdout),
        files=asked.effect_files,
    )
