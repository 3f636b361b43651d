"""What to do next: the experiment that would decide, or the repair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim.effects.effect import Effect

SPLITS: dict[frozenset[str], str] = {
    frozenset({"film_lag", "meter_lag", "timestamp_skew"}): (
        "steps with dwells and dithers inside the transition, at the fastest rate and at a third of it: "
        "corners inside the transition tell a lag from a delay"
    ),
    frozenset(
        {"sensor_lag", "timestamp_skew"}
    ): "an event that both instruments log, and steps of the current with dwells",
    frozenset({"actuator_delay", "sensor_lag"}): "steps of the current at full size, sampled as fast as the bench can",
    frozenset({"series_resistance", "memoryless_term"}): "measure with four wires",
    frozenset({"self_heating"}): "repeat the profile at a third of the test current: self-heating is then a ninth",
    frozenset({"film_drift", "ambient_drift"}): "repeat the first cycle at the end (A-B-A)",
    frozenset({"heat_sink_warmup", "ambient_drift"}): "log the sink's and the ambient's temperature",
    frozenset({"creep", "film_drift"}): "a long dwell inside the transition after a sweep, then the first cycle again",
}
LOG_CURRENTS = "log a row whenever the current changes, or current_time_s with it: between the rows it is not known"

ELSEWHERE = "another rate, and a dwell inside the transition"
HARDER = "steps of the drive of other sizes and both ways, with dwells until the temperature stands"
REPEAT_FILM = (
    "repeat the record: a residual that repeats with temperature is the film's, one that repeats with time the room's"
)
REPEAT_PLATE = (
    "repeat the record: a residual that repeats with the drive is that of plate and instruments, "
    "one that repeats with the time of day the room's"
)


def next_experiments(
    effects: Mapping[str, Effect],
    names: Sequence[str],
    confounders: Mapping[str, Sequence[str]],
    unexplained: Sequence[str],
    has_current: bool,
    has_test_current: bool,
    logs_currents: bool = True,
    has_film: bool = True,
) -> list[str]:
    """In the order in which they help. logs_currents: whether each change of the current is in the record."""
    found: list[str] = [] if logs_currents else [LOG_CURRENTS]
    for name in names:
        for rival in confounders.get(name, []):
            pair = frozenset({name, rival})
            text = next((t for group, t in SPLITS.items() if pair <= group), None)
            found.append(f"{name} or {rival}: {text or (ELSEWHERE if has_film else HARDER)}")
    found += [f"{name}: {effects[name].remedy}" for name in names if name in effects]
    if unexplained:
        found.append(REPEAT_FILM if has_film else REPEAT_PLATE)
    if not has_current:
        found.append("record current_A: without it the plate and the thermometer cannot be judged")
    if not has_test_current:
        found.append("record meter_current_A, and change it by a factor of 3 half-way: only this shows self-heating")
    return list(dict.fromkeys(found))
