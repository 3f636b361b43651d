"""One record diagnosed, with what is reported of it and the files of its report, as values: it may be done anywhere."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from rig.analysis.diagnosed import Asked, diagnosed, model_of
from rig.analysis.film_records import earlier_film_records, fitted_to
from rig.analysis.table_row import of_diagnosis
from rig.batch.engine import given
from rig.config.effect_tables import add_effect_files, parse_assumed_effects
from rig.config.model_file import Model, write_model
from rig.core.faults import Faults
from rig.records.record_file import Record
from rig.report.batch import CANDIDATE, MODEL, RecordReport, Task, files_in
from rig.report.diagnosis import write_diagnosis_report
from rig.report.diagnosis_words import lines, model_comment, unit_lines
from rig.report.diagnosis_words import together as records_of
from sim.diagnosis.extended_model import ExtendedModel, extended_model
from sim.diagnosis.result import with_model

RANK = (
    "partly_unexplained",
    "explained",
    "unexplained",
    "too_short",
    "clean",
)  # what there is to do about it, most first


@dataclass(frozen=True)
class Options:
    """asked: how to diagnose, without what is assumed; assume: NAME[:param=value,...] of effects that are there;
    effect_files: user-defined effects, which another process has to load too."""

    asked: Asked
    assume: tuple[str, ...] = ()
    effect_files: tuple[Path, ...] = ()


def told(
    record: Any,
    options: Options,
    model: str | None = None,
    *holdout: Any,
    report: bool | None = None,
    further: Sequence[Record] = (),
    say: Callable[[str], None] = lambda text: None,
) -> RecordReport:
    """Diagnose a record. record, holdout: `Record`s, or what an engine shares of them. model: where its model will
    stand; None: nowhere. report: whether its files are wanted; None: where the model is. further: records that are
    diagnosed with it as one; say: takes progress."""
    _know(options.effect_files)
    one: Record = given(record)
    earlier = earlier_film_records(one.source, say)
    together = [one, *further]
    asked = replace(options.asked, assume=parse_assumed_effects(options.assume))
    try:
        diagnosis, extended = diagnosed(together, asked, [given(other) for other in holdout], earlier, say)
    except Faults as faults:
        return RecordReport(faults=tuple(faults.lines))
    if model is not None:
        diagnosis = with_model(diagnosis, model)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if model is not None:
            write_model(folder / MODEL, _of_records(extended, together, earlier), model_comment(diagnosis))
        if report if report is not None else model is not None:
            for candidate in diagnosis.candidates[:1]:
                tried = extended_model(candidate.fit, diagnosis.record)
                comment = f"with what was found in {records_of(diagnosis)} and is not named: "
                comment = "\n".join([comment + ", ".join(candidate.names), *unit_lines(diagnosis)])
                write_model(folder / CANDIDATE, _of_records(tried, together, ()), comment)
            write_diagnosis_report(folder, diagnosis)
        files = files_in(folder)
    return RecordReport(diagnosis.document(), tuple(lines(diagnosis)), files)


def _of_records(extended: ExtendedModel, together: Sequence[Record], before: Sequence[Record]) -> Model:
    """The model, with the records that told its film, where they are files."""
    return fitted_to(model_of(extended), [*together, *(before if extended.further else [])])


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


def diagnoses(options: Options, holdout: Sequence[Record]) -> Task:
    """Of many records."""
    return Task(
        work=told,
        options=options,
        document="diagnosis.json",
        table="diagnoses",
        title="Diagnoses",
        row=of_diagnosis,
        rank=_rank,
        columns={"verdict": "verdict", "named": "effects and sizes", "left": "left over"},
        shared=tuple(holdout),
        files=options.effect_files,
    )
