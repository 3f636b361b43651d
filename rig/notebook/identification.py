"""Identify a film and its plate from records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from rig.analysis.film_numbers import FilmNumbers
from rig.analysis.identified import AskedFit, Identified, identified
from rig.config.model_file import Model
from rig.core.python_words import in_python
from rig.notebook.records import as_records
from rig.notebook.shown import Shown
from rig.records.film_output import FALLING_RESISTANCE
from rig.report.identified_records import compared, in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sim.inference.film.fit import FilmFit
    from sim.inference.plate.fit import PlateFit


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Shown):
    """A film and a plate that were fitted to records.

    model: both, as a model file has them. film: `sim.inference.film.fit.FilmFit`, None where no record has a
    resistance; rmse and held_out_rmse are in decades, or in the unit of the output. plate:
    `sim.inference.plate.fit.PlateFit`, None where no record has a current. transition: of each record, what
    it says of the film without a model. lines: what `peltier identify` prints; document: its JSON.
    """

    model: Model
    film: FilmFit | None
    plate: PlateFit | None
    transition: tuple[FilmNumbers, ...]
    lines: tuple[str, ...]
    document: dict[str, Any]
    found: Identified = field(repr=False)

    def plot(self) -> Figure:
        """Measured and modelled output over temperature, of the first record; without a film the predicted temperature
        over time."""
        from rig.notebook.prediction import predict
        from rig.report.model_figures import drawn_loop

        if self.film is None:
            return predict(self.model, self.found.records[0], initial="fitted").plot()
        one = compared(self.found)[0]
        return drawn_loop(one.time_s, one.degC, one.measured, one.modelled, self.found.output)


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
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
) -> Identification:
    """One film and one plate of all records: a film of those with a resistance, a plate of those with a current.

    record, further: `Record`s, or what `read_record` reads. output: the film's, where it is not a resistance: a column
    with its unit, "curvature_per_m". kind, form: of the film's model and of its memoryless function D(T), None: chosen
    by rows that are held out. operators: of play, to begin with; violate_order: allow radii with which the output
    jumps; compress: at most so many operators in the model. initial: the film's memory at the first row. plate: its
    kind. say: called with what was decided on the way. Raises Faults.
    """
    asked = AskedFit(output, kind, form, operators, initial, violate_order, compress, plate, seed)
    found = identified(as_records((record, *further)), asked, say)
    lines: list[str] = []
    document = in_words(found, lines.append)
    return Identification(found.model, found.film, found.plate, found.numbers, tuple(lines), document, found)
