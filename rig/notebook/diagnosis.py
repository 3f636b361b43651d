"""What the simulation of a rig gets wrong, why, and what the repair gains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from rig.analysis.diagnosed import Asked, diagnosed, model_of
from rig.config.effect_tables import add_effect_files, check_assumed_effects
from rig.config.model_file import Model
from rig.core.faults import fault
from rig.core.python_words import in_python
from rig.notebook.analysis import Shown
from rig.notebook.files import as_records
from rig.records.film_output import FALLING_RESISTANCE
from rig.report.diagnosis_words import lines, model_comment
from sim.diagnosis.result import Diagnosis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Base = Literal["extended_generalized_pi", "generalized_pi"]
Plate = Literal["peltier", "heater"]


@dataclass(frozen=True, eq=False, repr=False)
class RecordDiagnosis(Shown):
    """A diagnosis. verdict: clean, explained, partly_unexplained, unexplained or too_short. effects: the parameters of
    each effect that is named, by names that bear their units. model: the extended one, for `predict`. lines: what
    `peltier diagnose` prints; document: its JSON. found: everything, `sim.diagnosis.result.Diagnosis`. drive: its unit,
    where it is a share of full drive."""

    verdict: str
    effects: dict[str, dict[str, float]]
    model: Model
    lines: tuple[str, ...]
    document: dict[str, Any] = field(repr=False)
    found: Diagnosis = field(repr=False)
    drive: str | None = field(default=None, repr=False)

    def plot(self) -> Figure:
        """The loop as base and extended model show it; without a film the error on held-out rows."""
        from rig.report.diagnosis_figures import drawn_gain, drawn_loop

        return drawn_gain(self.found) if self.found.record.output is None else drawn_loop(self.found)

    def write_report(self, folder: Path | str) -> Path:
        """report.html with all figures, diagnosis.json and model.toml in a folder; its page. Raises OSError."""
        from rig.config.model_file import write_model
        from rig.report.diagnosis import write_diagnosis_report

        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        write_model(place / "model.toml", self.model, model_comment(self.found))
        write_diagnosis_report(place, self.found)
        return place / "report.html"


@in_python()
def diagnose(
    record: Any,
    *further: Any,
    holdout: Iterable[Any] = (),
    base: Base | None = None,
    output: str = FALLING_RESISTANCE,
    plate: Plate | None = None,
    assume: Mapping[str, Mapping[str, float]] | None = None,
    budget_s: float | None = None,
    false_alarm: float | None = None,
    first_s: float | None = None,
    effect_files: Iterable[Path | str] = (),
    say: Callable[[str], None] = lambda text: None,
) -> RecordDiagnosis:
    """Fit the whole chain, from the current to the ohmmeter, and name what departs from it (docs/diagnosis.md).

    record: a `Record`, or what `read_record` reads; further: more of the same rig, diagnosed with it as one. holdout:
    other records of the rig, on which the gain is measured. base: the film's model. plate: its kind, None: what the
    drive allows. assume: effects that are there, with the parameters that are known. budget_s: how long it may take.
    false_alarm: the share of records without any effect that may be given a name, None: 1 %. first_s: seconds of a
    held-out record to which its own room, first temperatures and memory are fitted, None: 30 s or 20 rows.
    effect_files: effects of one's own. say: called with what is being done. Raises Faults.
    """
    add_effect_files(Path(path) for path in effect_files)
    if budget_s is not None and not budget_s > 0.0:
        raise fault("diagnose", f"budget_s {budget_s:g}", "expected a number of seconds > 0")
    for name, value, choices in (("base", base, get_args(Base)), ("plate", plate, get_args(Plate))):
        if value is not None and value not in choices:
            raise fault("diagnose", f"{name} {value!r}", f"expected one of {', '.join(choices)}")
    known = check_assumed_effects([{"name": name, **values} for name, values in (assume or {}).items()], "assume")
    others = as_records(holdout)
    one, *more = as_records((record, *further))
    asked = Asked(base, output, plate, known, budget_s, false_alarm, first_s)
    found, extended = diagnosed([one, *more], asked, others, say=say)
    effects = {f.name: {name: value for name, (value, _) in f.parameters.items()} for f in found.findings}
    told = tuple(lines(found)), found.document(), found, one.drive
    return RecordDiagnosis(found.verdict, effects, model_of(extended), *told)
