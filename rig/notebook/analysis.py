"""Identify, predict, invert and diagnose in a notebook."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from rig.analysis.diagnosed import Asked, diagnosed, model_of
from rig.analysis.film_records import beyond_seen
from rig.analysis.identification import FitOptions, Identified, identified
from rig.analysis.inversion import Inversion, inverted
from rig.analysis.prediction import ChannelError, Prediction, compared, require_something_to_predict
from rig.analysis.transition import FilmNumbers
from rig.config.effect_tables import add_effect_files, check_assumed_effects
from rig.config.model_file import Model
from rig.core.faults import fault, in_python, python_words
from rig.notebook.files import as_model, as_record, as_records
from rig.records.film_output import FALLING_RESISTANCE
from rig.records.record import Record
from rig.report.diagnosis_words import lines, model_comment
from sim.diagnosis.result import Diagnosis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from compensator.hysteresis.functions import Array
    from sim.inference.film.fit import FilmFit
    from sim.inference.plate.fit import PlateFit


class Shown:
    """Base of results that show themselves: the lines that the command line prints, and in a notebook a figure."""

    lines: tuple[str, ...]

    @abstractmethod
    def plot(self) -> Figure:
        """Return a matplotlib Figure; `figure.savefig("figure.png")` keeps it."""

    def __str__(self) -> str:
        return python_words("\n".join(self.lines))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        from rig.report.page import svg_text

        svg = svg_text(self.plot())
        return f"<pre>{escape(str(self))}</pre>{svg[svg.index('<svg') :]}"


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Shown):
    """Film and plate that were fitted to records.

    model: both, as a model file has them. film: `sim.inference.film.fit.FilmFit`, None if no record has a
    resistance; rmse and held_out_rmse are in decades, or in the unit of the output. plate:
    `sim.inference.plate.fit.PlateFit`, None if no record has a current. transition: of each record, measured
    without a model. lines: what `peltier identify` prints; document: its JSON.
    """

    model: Model
    film: FilmFit | None
    plate: PlateFit | None
    transition: tuple[FilmNumbers, ...]
    lines: tuple[str, ...]
    document: dict[str, Any]
    found: Identified = field(repr=False)

    def plot(self) -> Figure:
        """Draw measured and modelled output over temperature, of the first record; without a film the predicted
        temperature over time."""
        from rig.report.model_pages import drawn_loop

        if self.film is None:
            return predict(self.model, self.found.records[0], initial="fitted").plot()
        return drawn_loop(*self.found.courses()[0], self.found.output)


@in_python()
def identify(
    record: Any,
    *further: Any,
    output: str = FALLING_RESISTANCE,
    kind: str | None = None,
    form: str | None = None,
    operators: int = 30,
    initial: Literal["cooled", "heated", "fitted"] = "fitted",
    violate_order: bool = False,
    compress: int | None = None,
    plate: Literal["peltier", "heater"] = "peltier",
    say: Callable[[str], None] = lambda text: None,
) -> Identification:
    """Fit one film to all records with a resistance, and one plate to all with a current.

    Parameters
    ----------
    record, *further : `Record`s, or what `read_record` reads
    output : output of the film if it is not a resistance: a column with its unit, "curvature_per_m"
    kind, form : of the film's model and of its memoryless function D(T); None: chosen by held-out rows
    operators : number of play operators to begin with
    initial : the film's memory at the first row
    violate_order : allow radii with which the output jumps at reversals
    compress : keep at most so many operators in the model
    plate : kind of the plate
    say : called with each decision on the way

    Returns
    -------
    Identification : model, fits and transition, with their intervals

    Raises
    ------
    Faults : for records that cannot be read, or to which nothing can be fitted
    """
    options = FitOptions(output, kind, form, operators, initial, violate_order, compress, plate)
    found = identified(as_records((record, *further)), options, say)
    lines, document = tuple(found.lines()), found.document()
    return Identification(found.model, found.film, found.plate, found.numbers, lines, document, found)


@dataclass(frozen=True, eq=False, repr=False)
class PredictedRecord(Shown):
    """A record as a model predicts it, each array of shape (rows,).

    columns: predicted_ohm (or predicted_ with the output's column) and predicted_degC; residual_dec and residual_K,
    measured - model. errors: of each channel that was measured too, over the rows to which nothing was fitted;
    rmse_dec, rmse_K: the same, None if there is none. fitted: the record's own state, if it was fitted: ambient_degC,
    first_degC, memory. notes: what to know of record, model and simulation.
    """

    columns: dict[str, Array]
    errors: tuple[ChannelError, ...]
    fitted: dict[str, Any]
    notes: tuple[str, ...]
    record: Record = field(repr=False)
    found: Prediction = field(repr=False)

    @property
    def rmse_dec(self) -> float | None:
        """RMS error of log10 R, decades."""
        return self._rmse("dec")

    @property
    def rmse_K(self) -> float | None:
        """RMS error of the plate's temperature, K."""
        return self._rmse("K")

    @property
    def lines(self) -> tuple[str, ...]:  # type: ignore[override]
        """Lines that `print` shows."""
        return (*(error.in_words() for error in self.errors), *self.notes) or ("nothing to compare",)

    def plot(self) -> Figure:
        """Draw measured and predicted over time, a panel for each channel."""
        from rig.report.model_pages import drawn_over_time

        return drawn_over_time(self.record["time_s"], self.errors)

    def _rmse(self, unit: str) -> float | None:
        return next((error.rmse for error in self.errors if error.unit == unit), None)


@in_python()
def predict(
    model: Any,
    record: Any,
    *,
    initial: Literal["cooled", "heated", "fitted"] | None = None,
    drive: Literal["current", "temperature"] | None = None,
    first_s: float | None = None,
    effect_files: Iterable[Path | str] = (),
) -> PredictedRecord:
    """Simulate the film's output and, from the record's current, the plate's temperature over a whole record.

    Parameters
    ----------
    model : a `Model`, an identification or a diagnosis, or the path of a model file
    record : a `Record`, or what `read_record` reads
    initial : the film's memory at the first row; None: the model's own. "fitted": memory, room and first temperatures
        are fitted to the first rows.
    drive : what the film follows, the simulated plate or the thermometer; None: as the model says
    first_s : duration of the rows that are fitted (s); None: 30 s or 20 rows, the longer
    effect_files : files with user-defined effects

    Returns
    -------
    PredictedRecord : predictions, and their errors over the rows to which nothing was fitted

    Raises
    ------
    Faults : for a model or a record that cannot be read, and if there is nothing to predict
    """
    add_effect_files(Path(path) for path in effect_files)
    known, where = as_model(model)
    rows = as_record(record)
    require_something_to_predict(known, rows, where, drive)
    found = compared(known, rows, where, initial=initial, drive=drive, first_s=first_s)
    return PredictedRecord(
        found.columns, found.errors, found.fitted, (*found.warnings, *found.notes), rows, found.found
    )


@in_python()
def invert(
    model: Any,
    target: ArrayLike,
    *,
    limits_degC: tuple[float, float] = (-50.0, 200.0),
    initial: Literal["cooled", "heated"] | None = None,
) -> Inversion:
    """Return temperatures that give the film these values one after the other, its memory carried along.

    A target that cannot be reached leaves the temperature as it is: `reachable` is False there, and `nearest` is the
    nearest value that the film could have. Warns if the film was not measured at such temperatures.

    Parameters
    ----------
    model : a `Model`, an identification or a diagnosis, or the path of a model file
    target : shape (rows,), in ohm, or in the unit of the film's output
    limits_degC : lowest and highest temperature
    initial : the film's memory before the first row; None: the model's own

    Returns
    -------
    Inversion : temperatures (degC), and the values that the film has there

    Raises
    ------
    Faults : for a model without a film, and for values that are no target
    """
    known, where = as_model(model)
    if known.film is None:
        raise fault(where, "film", "missing; expected a [film] to invert")
    if not -273.15 <= limits_degC[0] < limits_degC[1] <= 1e6:
        raise fault("invert", f"limits_degC {limits_degC}", "expected LOW < HIGH, degC")
    try:
        wanted = np.atleast_1d(np.asarray(target, dtype=np.float64))
    except (TypeError, ValueError):
        raise fault("invert", "target", "expected numbers") from None
    if wanted.ndim != 1:
        raise fault("invert", "target", f"{wanted.ndim} dimensions; expected one")
    found = inverted(known.film, wanted, "target", limits_degC, initial, known.mixing)
    note = beyond_seen(known, found.asked_degC, where)
    if note is not None:
        warnings.warn(note, stacklevel=3)
    return found


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
        """Draw the loop as base and extended model show it; without a film the temperature over time."""
        from rig.report.diagnosis import drawn_course, drawn_loop

        return drawn_course(self.found) if self.found.record.output is None else drawn_loop(self.found)

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
