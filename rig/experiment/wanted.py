"""Target and model of a configured experiment, checked before any port is opened and anything is switched on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, cast

from rig.analysis.beyond_seen import beyond_seen
from rig.analysis.predicted import needs_test_current
from rig.config.configuration import Configuration, ConfigurationFile
from rig.config.model_file import Model, read_model
from rig.config.target import Target, parse_profile, read_target
from rig.control.decision import Policy
from rig.control.law_units import in_law_units, law_units
from rig.control.policies import CurrentProfile
from rig.core.faults import Faults, fault
from rig.experiment.calibration import calibration_range
from rig.experiment.extended_model import own_target
from rig.experiment.feasible import (
    Course,
    behind_warning,
    check_cooling,
    check_plate,
    check_target,
    check_within_limits,
    grid,
    memory_warning,
    order_warning,
)
from rig.experiment.repeated import LEARNED, read_correction
from rig.records.film_output import FALLING_RESISTANCE, in_decades, other_sign

QUANTITY = {
    "track_resistance": "resistance",
    "temperature_profile": "temperature",
    "current_profile": "current",
    "hold": "temperature",
}
TRACKING = ("track_resistance", "track_output")

# kinds that command a current by a policy of their own, without a law; the others follow a temperature
OWN_POLICY: Mapping[str, Callable[[Target, Configuration], Policy]] = {
    "current_profile": lambda target, configuration: CurrentProfile(target),
}


def quantity_of(configuration: Configuration) -> str:
    """What the target is of: see `rig.config.target.Target`."""
    e, meter = configuration.experiment, configuration.bench.meter
    if e.kind != "track_output":
        return QUANTITY[e.kind]
    assert meter is not None
    assert meter.output is not None
    return meter.output


def target_of(file: ConfigurationFile) -> Target:
    """The wanted course. Raises Faults."""
    e = file.content.experiment
    quantity = quantity_of(file.content)
    if e.target is None:
        raise fault(file.path, "experiment.target", f"missing; kind {e.kind!r} needs a CSV file or a profile in words")
    if isinstance(e.target, str):
        return read_target(file.beside(e.target), quantity)
    return parse_profile(e.target, quantity, f"{file.path}: experiment.target")


def wanted(file: ConfigurationFile, say: Callable[[str], None]) -> tuple[Target, Model | None]:
    """Target and model of the configured experiment, checked before any port is opened. Raises Faults."""
    e = file.content.experiment
    target, model = _target_and_model(file)
    for line in target.notes:
        say(line)
    if e.kind in ("temperature_profile", "hold") and model is None and e.law != "instrument_pid":
        expected = "needs a model with [plate], or law = 'instrument_pid' (the controller's own PID)"
        raise fault(file.path, "experiment.model", f"missing; kind {e.kind!r} {expected}")
    if (e.repeat > 1 or e.learned is not None) and e.kind != "track_resistance":
        text = f"kind {e.kind!r}; expected 'track_resistance': a resistance is what repetitions learn"
        raise fault(file.path, "experiment.repeat", text)
    if e.learned is not None:
        read_correction(file.beside(e.learned) / LEARNED)
    if model is not None:
        check_feasible(file, target, model, say)
    return target, model


def _target_and_model(file: ConfigurationFile) -> tuple[Target, Model | None]:
    """Both files read, the target within the limits. Raises Faults: those of both."""
    e, lines = file.content.experiment, list[str]()
    target, model = None, None
    try:
        target = target_of(file)
        check_within_limits(target, file.content, f"{file.path}: experiment.target")
    except Faults as faults:
        lines += faults.lines
    try:
        if e.model is not None:
            needs = ("film", "plate") if e.kind in TRACKING else ("plate",)
            model = read_model(file.beside(e.model), needs=cast(Any, needs))
    except Faults as faults:
        lines += faults.lines
    if lines or target is None:
        raise Faults(lines)
    return target, model


def check_feasible(file: ConfigurationFile, target: Target, model: Model, say: Callable[[str], None]) -> None:
    """Refuse what film or plate cannot do, before anything is switched on. Raises Faults."""
    c, where = file.content, f"{file.path}: experiment.target"
    hot = calibration_range(c)[1]
    told = check_cooling(model.plate, target, c, where) if model.plate is not None else None
    if told is not None:
        say(told)
    if c.experiment.kind == "current_profile":
        return
    if c.experiment.kind in TRACKING:
        assert model.film is not None
        _check_output(model, c.experiment.model or file.path, quantity_of(c))
        units = law_units(model.film, c.limits.temperature_degC)
        film = in_law_units(model.film, units)
        for warning in (
            order_warning(film, c.experiment.model or str(file.path)),
            memory_warning(film, hot, c.experiment.model or str(file.path), units),
        ):
            if warning is not None:
                say(warning)
        own = own_target(target, film, model.switched(), units)
        course = check_target(own, film, model.plate, c, hot, where, units)
        if course.planned:
            say("the target has several temperatures: not always the nearest is taken, so that all of it is reached")
        beyond = beyond_seen(model, course.temperatures_degC, c.experiment.model or str(file.path))
        if beyond is not None:
            say(beyond)
        if model.plate is not None and c.experiment.law != "instrument_pid":
            check_plate(model.plate, [hot], c, f"{file.path}: calibration.temperature_degC", "its hot end")
    else:
        times = grid(target)
        course = Course(times, target.at(times))
    if model.plate is not None and c.experiment.law != "instrument_pid":
        ends = [float(course.temperatures_degC.min()), float(course.temperatures_degC.max())]
        check_plate(model.plate, ends, c, where, "its range")
        behind = behind_warning(model.plate, course, c)
        if behind is not None:
            say(behind)


def _check_output(model: Model, where: object, quantity: str) -> None:
    """Refuse a film that the wanted quantity cannot be tracked with. Raises Faults."""
    assert model.film is not None
    output = model.film.output
    if quantity == "resistance" and not in_decades(output):
        raise fault(where, "film.output", f"{output!r}; expected a resistance to track one")
    if quantity != "resistance" and output not in (quantity, other_sign(quantity)):
        raise fault(where, "film.output", f"{output!r}; expected {quantity!r}, which the meter reads, to track it")
    on_readings = [e for e in model.switched() if e.effect.link == "ohmmeter" or needs_test_current((e,))]
    if output != FALLING_RESISTANCE and on_readings:
        what = "whose resistance rises" if quantity == "resistance" else "of which no resistance is read"
        name = on_readings[0].name
        raise fault(where, "effects", f"{name}: has no meaning for a film {what} (film.output {output!r})")
