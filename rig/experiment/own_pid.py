"""Gains of the controller's own PID: those that a configuration sets, or, where it sets none, those for this plate."""

from __future__ import annotations

from dataclasses import dataclass

from compensator.control.design import Design, OwnPid, design_own_pid, steepest_slope
from compensator.control.margins import NOISES_K
from compensator.hysteresis.film import FilmModel
from compensator.thermal.plate import PlateModel
from rig.config.configuration import Configuration
from rig.drivers.controller import OwnField
from rig.drivers.own_gains import configured_pid, own_fields, set_pid


@dataclass(frozen=True)
class OwnTuning:
    """The controller's own PID: gains, the design they come from, the instrument's fields (None: not known)."""

    pid: OwnPid
    design: Design
    fields: list[OwnField] | None


def own_tuning(configuration: Configuration, film: FilmModel, plate: PlateModel) -> OwnTuning:
    """Gains of the controller's own PID for this plate, where the film is steepest, as fine as the instrument keeps
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
    """The one that the resistance's loop is designed around."""
    controller = configuration.bench.controller
    given = configured_pid(controller.driver, controller.options, configuration.limits.current_A)
    return given if given is not None else own_tuning(configuration, film, plate).pid
