"""What a configuration asks for, checked before a port is opened: target, model, and whether both can be done."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from rig.analysis.predicted import needs_test_current
from rig.core.faults import fault
from rig.experiment.calibration import calibration_range
from rig.experiment.extended_model import own_target
from rig.experiment.feasible import check_cooling, check_plate, check_target, memory_warning, order_warning
from rig.experiment.repeated import LEARNED, read_correction
from rig.files.configuration import ConfigurationFile
from rig.files.film_output import RISING_RESISTANCE, in_decades
from rig.files.model_file import Model, read_model
from rig.files.target import Target, read_target, target_in_words

QUANTITY = {
    "track_resistance": "resistance",
    "temperature_profile": "temperature",
    "current_profile": "current",
    "hold": "temperature",
}


def target_of(file: ConfigurationFile) -> Target:
    """The wanted course. Raises Faults."""
    e = file.content.experiment
    quantity = QUANTITY[e.kind]
    if e.target is None:
        raise fault(file.path, "experiment.target", f"missing; kind {e.kind!r} needs a CSV file or a profile in words")
    if isinstance(e.target, str):
        return read_target(file.beside(e.target), quantity)
    return target_in_words(e.target, quantity, f"{file.path}: experiment.target")


def wanted(file: ConfigurationFile, say: Callable[[str], None]) -> tuple[Target, Model | None]:
    """Target and model of the configured experiment, checked before any port is opened. Raises Faults."""
    e = file.content.experiment
    target = target_of(file)
    for line in target.said:
        say(line)
    model = None
    if e.model is not None:
        needs = ("film", "plate") if e.kind == "track_resistance" else ("plate",)
        model = read_model(file.beside(e.model), needs=cast(Any, needs))
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


def check_feasible(file: ConfigurationFile, target: Target, model: Model, say: Callable[[str], None]) -> None:
    """Refuse what film or plate cannot do, before anything is switched on. Raises Faults."""
    c, where = file.content, f"{file.path}: experiment.target"
    hot = calibration_range(c)[1]
    temperatures = target.values
    told = check_cooling(model.plate, target, c, where) if model.plate is not None else None
    if told is not None:
        say(told)
    if c.experiment.kind == "current_profile":
        return
    if c.experiment.kind == "track_resistance":
        assert model.film is not None
        _check_output(model, c.experiment.model)
        for warning in (
            order_warning(model.film, c.experiment.model),
            memory_warning(model.film, hot, c.experiment.model),
        ):
            if warning is not None:
                say(warning)
        own = own_target(target, model.film, model.switched())
        temperatures = check_target(own, model.film, c, hot, where)
        if model.plate is not None and c.experiment.law != "instrument_pid":
            check_plate(model.plate, [hot], c, f"{file.path}: calibration.temperature_degC", "its hot end")
    if model.plate is not None and c.experiment.law != "instrument_pid":
        check_plate(model.plate, [float(temperatures.min()), float(temperatures.max())], c, where, "its range")


def _check_output(model: Model, where: object) -> None:
    """Refuse a film that no resistance can be tracked with. Raises Faults."""
    assert model.film is not None
    output = model.film.output
    if not in_decades(output):
        raise fault(where, "film.output", f"{output!r}; expected a resistance to track one")
    on_readings = [e for e in model.switched() if e.effect.link == "ohmmeter" or needs_test_current((e,))]
    if output == RISING_RESISTANCE and on_readings:
        text = "has no meaning for a film whose resistance rises (film.output 'log10_ohm')"
        raise fault(where, "effects", f"{on_readings[0].name}: {text}")
