"""`peltier tune`: gains, the margins of the whole law at the film's slopes, the controller's own PID.

Gains whose margins do not hold are refused, with what to lower to which value: the share of a reading that the
resistance's feedback takes, or, if that is not enough, the temperature's gains. The gains of the controller's own PID
are those that a configuration sets, or, if it sets none, those for this plate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from typing import Any

from compensator.control.law import Law
from compensator.control.law_step import LawName
from compensator.control.margins import (
    NOISES_K,
    RATIOS,
    LoopMargins,
    Point,
    Timing,
    critical_gain,
    critical_ratio,
    least,
    loop_margins_at,
    operating_points,
    share_within,
    worst_ms,
)
from compensator.control.pid import Design, OwnPid, design_own_pid, steepest_slope
from compensator.hysteresis.film import FilmModel
from compensator.thermal.plate import PlateModel
from rig.config.configuration import Configuration
from rig.config.model_file import Model
from rig.control.law_units import COMPENSATED, chain_observer
from rig.drivers.controller import OwnField
from rig.drivers.registry import configured_pid, own_fields, set_pid
from rig.experiment.tracking import law_and_design


@dataclass(frozen=True)
class OwnTuning:
    """The controller's own PID: gains, the design they come from, the instrument's fields (None: not known)."""

    pid: OwnPid
    design: Design
    fields: list[OwnField] | None


def own_tuning(configuration: Configuration, film: FilmModel, plate: PlateModel) -> OwnTuning:
    """Design the controller's own PID for this plate, where the film is steepest, as fine as the instrument keeps
    them. The dead time is a tick of the controller.
    """
    limit = configuration.limits.current_A
    _, middle = steepest_slope(film, *configuration.limits.temperature_degC)
    hold = plate.current_for_rate_A(middle, 0.0, limit)
    gain, pole = plate.linearized(middle, hold)
    tick = OwnPid(1.0, 1.0).tick_s
    pid, design = design_own_pid(gain, max(pole, 0.0), tick, tick, configuration.control.ms, NOISES_K[0], limit)
    controller = configuration.bench.controller
    fields = own_fields(controller.driver, controller.options, pid, limit)
    return OwnTuning(set_pid(fields, controller.driver, limit) if fields is not None else pid, design, fields)


def own_pid(configuration: Configuration, film: FilmModel, plate: PlateModel) -> OwnPid:
    """Return the controller's own PID around which the resistance's loop is designed: configured or designed here."""
    controller = configuration.bench.controller
    given = configured_pid(controller.driver, controller.options, configuration.limits.current_A)
    return given if given is not None else own_tuning(configuration, film, plate).pid


LARGEST_MS, LEAST_PHASE_DEG = 2.0, 30.0  # Ms 2: L keeps half its distance to -1, and bears a factor of 2 in gain
MILDEST_MS = 1.1  # milder gains hardly follow


@dataclass(frozen=True)
class Row:
    """The least of each margin over all operating points at one ratio of slopes, and where Ms is largest."""

    ratio: float
    margins: LoopMargins
    way: str
    degC: float
    noise_K: float


@dataclass(frozen=True, eq=False)
class WholeLaw:
    """One law's margins, of a film on its way up and down. rings_at_ratio, rings_at_gain: the film's slope and the
    plate's answer, over the model's, from which it rings on. rest: the least margins of a film at rest, within the band
    where the resistance is not fed back. refused: lines, none where the margins hold."""

    name: LawName
    most_share: float
    timing: Timing
    rows: list[Row]
    rings_at_ratio: float
    rings_at_gain: float
    rest: LoopMargins
    points: list[Point]
    refused: list[str] = field(default_factory=list)


def whole_law(configuration: Configuration, law: Law, timing: Timing, own: OwnPid | None) -> WholeLaw:
    """Return the law's margins over the plate's range and the film's slopes."""
    every = [point for noise_K in NOISES_K for point in operating_points(law, timing, noise_K, own)]
    points, rows = moving(every), []
    for ratio in RATIOS:
        each = [loop_margins_at(point, ratio) for point in points]
        point = points[max(range(len(each)), key=lambda k, each=each: each[k].ms)]  # type: ignore[misc]
        rows.append(Row(ratio, least(each), point.way, point.degC, point.noise_K))
    name = law.settings.name
    found = WholeLaw(
        name,
        law.settings.most_share,
        timing,
        rows,
        min(critical_ratio(point) for point in points),
        min(critical_gain(point) for point in points),
        least([loop_margins_at(point, 1.0) for point in every if point not in points]),
        every,
    )
    return replace(found, refused=_refused(configuration, law, found, own))


def moving(points: Sequence[Point]) -> list[Point]:
    """Return the points at which the film is on its way, so that the resistance is fed back."""
    return [point for point in points if point.way != "at rest"]


def _refused(configuration: Configuration, law: Law, found: WholeLaw, own: OwnPid | None) -> list[str]:
    """Return a line for each run of ratios at which the margins do not hold, and one on what to lower."""
    lines = []
    failing = [row for row in found.rows if not _holds(row.margins)]
    for _, same in groupby(failing, key=lambda row: (row.way, row.degC, row.noise_K, round(row.margins.ms, 2))):
        rows = list(same)
        m = rows[0].margins
        ratios = f"slope ratio {rows[0].ratio:g}" + (f" to {rows[-1].ratio:g}" if len(rows) > 1 else "")
        where = f"{ratios} ({rows[0].way}, {rows[0].degC:.1f} degC, thermometer noise {rows[0].noise_K:g} K)"
        if not m.stable:
            lines.append(f"{where}: the loop rings on by itself; expected one that settles")
            continue
        lines.append(
            f"{where}: Ms {m.ms:.2f}, phase margin {m.phase_margin_deg:.0f} deg; expected at most "
            f"{LARGEST_MS:g} and at least {LEAST_PHASE_DEG:g} deg"
        )
    return [*lines, _lower(configuration, law, found, own)] if lines else []


def _holds(margins: LoopMargins) -> bool:
    return margins.stable and margins.ms <= LARGEST_MS and margins.phase_margin_deg >= LEAST_PHASE_DEG


def _lower(configuration: Configuration, law: Law, found: WholeLaw, own: OwnPid | None) -> str:
    """Return the line on which gain to lower, to what value."""
    share = math.floor(100.0 * share_within(Law(law.settings, law.plate, law.film), found.timing, own)) / 100.0
    if 0.0 < share < found.most_share:
        return f"lower control.most_share from {found.most_share:.2f} to {share:.2f}"
    if own is not None:
        return "lower the controller's own Kp: set the gains printed below"
    ms = configuration.control.ms
    while ms > MILDEST_MS:
        ms = round(ms - 0.05, 2)
        tried = _with_ms(configuration, ms)
        slower, design = law_and_design(law.settings.name, tried, _film(law), law.plate, law.observer)
        points = moving([p for noise in NOISES_K for p in operating_points(slower, found.timing, noise)])
        if all(worst_ms(points, ratio) <= LARGEST_MS for ratio in RATIOS):
            kp = f"the temperature's Kp from {law.settings.gains.kp:.3g} to {design.gains.kp:.3g} 1/s"
            return f"lower control.ms from {configuration.control.ms:g} to {ms:g}: {kp}"
    return "no gain helps: shorten control.dead_time_s (a faster line), or lengthen experiment.period_s"


def _with_ms(configuration: Configuration, ms: float) -> Configuration:
    return configuration.model_copy(update={"control": configuration.control.model_copy(update={"ms": ms})})


def _film(law: Law) -> FilmModel:
    assert law.film is not None
    return law.film


def tuned_law(configuration: Configuration, model: Model, name: LawName, timing: Timing) -> tuple[WholeLaw, Design]:
    """Return a law as a run would have it, with its margins; "instrument_pid" with the controller's PID in it."""
    assert model.plate is not None
    assert model.film is not None
    observer = None
    if name in COMPENSATED:
        observer = chain_observer(model.switched(), model.plate, model.film, timing.period_s)
    law, design = law_and_design(name, configuration, model.film, model.plate, observer)
    own = own_pid(configuration, model.film, model.plate) if name == "instrument_pid" else None
    return whole_law(configuration, law, timing, own), design


def law_table(found: WholeLaw) -> dict[str, Any]:
    """Return a law's margins for the JSON."""
    return {
        "most_share": found.most_share,
        "timing": asdict(found.timing),
        "slope_ratios": [
            {
                "ratio": row.ratio,
                **asdict(row.margins),
                "worst_at": {"way": row.way, "temperature_degC": row.degC, "noise_K": row.noise_K},
            }
            for row in found.rows
        ],
        "at_rest": asdict(found.rest),
        "rings_from_slope_ratio": found.rings_at_ratio,
        "rings_from_plate_gain": found.rings_at_gain,
        "refused": found.refused,
    }


def own_table(own: OwnTuning) -> dict[str, Any]:
    """Return the controller's own gains for the JSON."""
    return {
        "kp_A_per_K": own.pid.kp_A_per_K,
        "ti_s": own.pid.ti_s,
        "td_s": own.pid.td_s,
        "margins": asdict(own.design.margins),
        "options": {each.option: each.value for each in own.fields} if own.fields is not None else None,
        "commands": list(dict.fromkeys(each.command for each in own.fields)) if own.fields is not None else None,
    }
