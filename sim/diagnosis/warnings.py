"""What a user should know besides the verdict: what the record lacks, what it cannot show, what may be off."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from sim.diagnosis.result import Caution, UpperLimit, rough
from sim.diagnosis.row_warnings import row_warnings
from sim.effects.effect import Effect
from sim.inference.joint.likelihood import Fit
from sim.inference.record.record import Record

ALIKE: Final = 0.1  # relative difference of two lags: instruments and films that are independent differ by more


def warnings_of(
    record: Record, fit: Fit, limits: Sequence[UpperLimit], left: Iterable[str], known: Mapping[str, Effect]
) -> list[Caution]:
    """Return all warnings that apply. left: the channels with residual structure ("temperature", "output")."""
    found = [*row_warnings(record), *_constant_columns(record)]
    if record.current_A is None:
        found.append(Caution("no_current", "no current_A: plate, driver and thermometer were not judged"))
    if record.output is None:
        found.append(Caution("no_resistance", f"no {record.quantity.column}: film and its meter were not judged"))
    elif not record.quantity.is_resistance:
        text = "series resistance, leakage, ranges and self-heating were not judged: they are a resistance's"
        found.append(Caution("no_resistance", f"{record.quantity.column}: {text}"))
    elif record.test_current_A is None:
        found.append(Caution("no_test_current", "no meter_current_A: self-heating was not judged"))
    if record.early > 0.0:
        text = (
            f"the current changed between the rows, where no row has it ({record.early:.0%} of a change had acted "
            "before its row, on average): its mean was taken, so that the model's error is larger than the noise"
        )
        found.append(Caution("current_between_rows", text))
    if "output" in left:
        text = (
            "the film's residual has structure: its cause is not in the catalogue, or the film model does not fit this "
            "film; limits and intervals of effects on film and ohmmeter may be too narrow"
        )
        found.append(Caution("film_not_described", text))
    else:
        found += [_absorbed(limit, known) for limit in limits if _hidden(limit)]
    return [*found, *_alike_lags(fit), *_coloured_noise(record, fit)]


def _hidden(limit: UpperLimit) -> bool:
    """Return True if plate or film can stand in for an effect of medium size."""
    if limit.typical is None or not limit.absorbed:
        return False
    middle = (limit.typical[0] * limit.typical[1]) ** 0.5
    return limit.limit is None or (limit.limit < middle if limit.from_below else limit.limit > middle)


def _absorbed(limit: UpperLimit, known: Mapping[str, Effect]) -> Caution:
    side = "above" if limit.from_below else "below"
    size = "of any typical size" if limit.limit is None else f"with {limit.parameter} {side} {rough(limit.limit)}"
    by = "plate" if known[limit.name].before_film else "film"
    return Caution(f"absorbed_by_the_{by}", f"{limit.name} {size} would not show: the fitted {by} absorbs it")


def _constant_columns(record: Record) -> list[Caution]:
    """Of what is logged about the plate and does not change."""
    found = []
    for name, (low, high) in record.constant_inputs.items():
        all_rows = f"{low:g} in all rows" if low == high else f"{low:g} to {high:g}, the same throughout each record"
        text = f"{name}: {all_rows}: not used, since only changes of it show how it acts on the plate"
        if name == "ambient_degC":
            text += "; the room is found from the plate alone, and should agree with it"
        found.append(Caution("constant_column", text))
    return found


def _alike_lags(fit: Fit) -> list[Caution]:
    """Of a thermometer and a film that lag alike, as one lag of the current before the plate makes them."""
    tau_s = {name: values["tau_s"] for name, values in fit.values().items() if "tau_s" in values}
    thermometer = tau_s.get("sensor_lag")
    for name in ("film_lag", "meter_lag"):
        if thermometer is not None and name in tau_s and abs(tau_s[name] / thermometer - 1.0) < ALIKE:
            text = (
                f"sensor_lag and {name} are alike ({thermometer:.2g} and {tau_s[name]:.2g} s): one lag of the current, "
                "before the plate, looks so in both; see how the driver follows its command first"
            )
            return [Caution("lags_alike", text)]
    return []


def _coloured_noise(record: Record, fit: Fit) -> list[Caution]:
    """Of instruments whose noise is correlated in time."""
    units = {"thermometer": (1.0, "K"), "ohmmeter": (record.quantity.size, record.quantity.unit)}
    own = [
        f"the {instrument}'s, {size * channel.noise.slow:.2g} {unit} over about {channel.noise.tau_s:.2g} s"
        for (instrument, (size, unit)), channel in zip(units.items(), fit.metric.channels, strict=False)
        if channel.of_instrument
    ]
    if not own:
        return []
    text = (
        f"the noise is correlated in time, as behind a filter or with 1/f noise: {' and '.join(own)}. Slow effects no "
        "larger than that would not have been seen"
    )
    return [Caution("coloured_noise", text)]


def out_of_time(seconds: float) -> Caution:
    """Return the warning of a search that its time cut short."""
    text = f"the search was ended by its budget of {seconds:.3g} s: this is the best result until then, and effects "
    text += "that were not tried may be there"
    return Caution("out_of_time", text)
