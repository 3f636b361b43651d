"""How a case of each kind is made, and what can be chosen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tests.sim.diagnosis.cases import Case
from tests.sim.diagnosis.truth.combine import TRIES, drawn_names, recorded_current, with_effects
from tests.sim.diagnosis.truth.controls import CONTROLS
from tests.sim.diagnosis.truth.designs import DESIGNS, drawn_design
from tests.sim.diagnosis.truth.disturb import DISTURBANCES, disturbed, uneven
from tests.sim.diagnosis.truth.draw import Bench, draw_bench, in_domains
from tests.sim.diagnosis.truth.films import FORMS
from tests.sim.diagnosis.truth.manner import UNLIKE, USUAL
from tests.sim.diagnosis.truth.oracle import Oracle, threshold
from tests.sim.diagnosis.truth.outside import OUTSIDE, with_fault
from tests.sim.diagnosis.truth.real_noise import COLOURS, coloured_record, drawn_instruments, record_of
from tests.sim.diagnosis.truth.rig import Effects, record
from tests.sim.diagnosis.truth.sizes import MARGIN, SIZES, bounds, others, slower, smallest

Random = np.random.Generator
# "smallest" is asked only of effects whose limit is of a size that one meets: at least this share of the least one
NOT_TRIFLING = 0.25
FURTHER = ("moving", "medium", "mixed")  # films that relays and a curve alone do not tell to the noise
DOMAINS = (100, 3000)  # that a film of such a case has, least and most
BESIDE_DOMAINS = (
    "actuator_delay",
    "heat_sink_warmup",
    "ambient_drift",
    "sensor_lag",
    "film_lag",
    "self_heating",
    "film_drift",
    "creep",
    "meter_lag",
    "timestamp_skew",
)
FEW_TRIES = 12
LIMITED = (
    "actuator_deadband",
    "radiative_loss",
    "self_heating",
    "series_resistance",
    "parallel_leakage",
    "meter_range_error",
)


def finished(rng: Random, kind: str, seed: int, bench: Bench, effects: Effects, expectation: str, **more: Any) -> Case:
    """Record and hold-out of the bench with its effects."""
    rig = bench.rig.having(effects)
    columns = record(rig, bench.schedule, rng)
    return Case(
        kind=kind,
        seed=seed,
        columns=columns,
        hidden=effects,
        expectation=expectation,
        film=rig.film.name,
        noise={"temperature_K": rig.noise_K, "resistance_dec": rig.noise_dec},
        holdout=record(rig, bench.elsewhere, rng),
        bench=bench,
        **more,
    )


def several(kind: str, count: int) -> Callable[..., Case]:
    """Cases with so many hidden effects; `effect` or `effects` chooses them, `film` the kind of film."""

    def make(
        rng: Random,
        seed: int,
        effect: str | None = None,
        effects: tuple[str, ...] = (),
        film: str = "of_class",
        rows: int | None = None,
    ) -> Case:
        names = (effect,) if effect else tuple(effects)
        if names == ("memoryless_term",):
            return memoryless_term(rng, seed)
        if not names:
            names = drawn_names(rng, count)
        bench, hidden, shares = with_effects(rng, names, film, rows)
        return finished(rng, kind, seed, bench, hidden, "exactly", details={"smallest_share": shares})

    return make


def clean(rng: Random, seed: int, film: str = "of_class", rows: int | None = None) -> Case:
    """No effect at all."""
    return finished(rng, "clean", seed, draw_bench(rng, film, rows=rows), {}, "clean")


def memoryless_term(rng: Random, seed: int) -> Case:
    """A D(T) that a base of play operators alone cannot carry; found only with that base."""
    for _ in range(TRIES):
        bench = draw_bench(rng, form=int(rng.integers(1, 4)))
        film = bench.rig.film
        bare = replace(film, form=0, d=np.array([0.0, 0.0, 0.0, film.d[3]]))
        oracle = Oracle(replace(bench.rig, film=bare), bench.schedule, recorded_current(bench, {}), free_d=False)
        weak = replace(film, d=film.d * np.array([1.0 / MARGIN, 1.0, 1.0, 1.0]))
        if oracle.evidence_of(oracle.with_film(weak)) > threshold(2):
            break
    else:
        raise RuntimeError("no film shows its memoryless term")
    hidden = {"memoryless_term": {"form": float(film.form), "amplitude": float(film.d[0])}}
    made = finished(rng, "one", seed, bench, {}, "exactly", options={"base": "generalized_pi"})
    return replace(made, hidden=hidden, details={"form": FORMS[film.form]})


def other_film(rng: Random, seed: int, film: str | None = None, rows: int | None = None) -> Case:
    """A film outside the class and no effect."""
    film = film or ("preisach", "forc")[seed % 2]
    return finished(rng, "other_film", seed, draw_bench(rng, film, rows=rows), {}, "no_name")


def other_film_effect(rng: Random, seed: int, film: str | None = None, effect: str | None = None) -> Case:
    """A film outside the class and one effect; of those drawn the first that shows beside a film of any density."""
    film = film or ("preisach", "forc")[seed % 2]
    while True:
        try:
            bench, hidden, shares = with_effects(rng, (effect or drawn_names(rng, 1)[0],), film, tries=FEW_TRIES)
            break
        except RuntimeError:
            if effect is not None:
                raise
    return finished(rng, "other_film_effect", seed, bench, hidden, "exactly", details={"smallest_share": shares})


def further_film(rng: Random, seed: int, film: str | None = None, effect: str | None = None) -> Case:
    """Films that relays and a curve do not tell to the noise: a moving Preisach film, one that percolates, and one that
    mixes otherwise than in logarithms; every other three with an effect."""
    film = film or FURTHER[seed % len(FURTHER)]
    bare = effect is None and seed // len(FURTHER) % 2 == 0
    made = other_film(rng, seed, film) if bare else other_film_effect(rng, seed, film, effect)
    return replace(made, kind="further_film")


def domains(
    rng: Random,
    seed: int,
    effect: str | None = None,
    fault: str | None = None,
    count: int | None = None,
    rows: int | None = None,
    smooth: str = "preisach",
    manner: str | None = None,
) -> Case:
    """A film of some hundred or thousand domains that switch one by one; every other with an effect. Its size is drawn
    beside a smooth film of the same density. fault: in place of an effect, one that has no name; count: of domains;
    smooth: the film that they are drawn from; manner: one of `UNLIKE`, of a record with no fault."""
    count = count or int(np.exp(rng.uniform(*np.log(DOMAINS))))
    hidden: Effects = {}
    taken = UNLIKE[manner] if manner else USUAL
    if fault is not None:
        bench, value, _ = with_fault(rng, fault, smooth)
        bench = replace(bench, rig=replace(bench.rig, outside={fault: value}))
    elif effect is None and seed % 2 == 0:
        bench = draw_bench(rng, smooth, rows=rows, manner=taken)
    else:
        name = effect or str(rng.choice(BESIDE_DOMAINS))
        bench, hidden, _ = with_effects(rng, (name,), smooth, rows, manner=taken)
    film = in_domains(rng, bench.rig.film, count)
    bench = replace(bench, rig=replace(bench.rig, film=film))
    expectation = "unexplained" if fault is not None else "exactly" if hidden else "clean"
    return finished(rng, "domains", seed, bench, hidden, expectation, details={"domains": count})


def outside_the_catalogue(rng: Random, seed: int, fault: str | None = None) -> Case:
    """A fault that has no name in the catalogue; `fault` chooses one of `outside.OUTSIDE`."""
    fault = fault or OUTSIDE[seed % len(OUTSIDE)]
    bench, value, left = with_fault(rng, fault)
    bench = replace(bench, rig=replace(bench.rig, outside={fault: value}))
    return finished(rng, "outside", seed, bench, {}, "unexplained", details={"fault": fault, **left})


def indistinguishable(rng: Random, seed: int, design: str | None = None) -> Case:
    """A poor record of an effect that has doubles, and the record that decides."""
    drawn = drawn_design(rng, design or DESIGNS[seed % len(DESIGNS)])
    made = finished(rng, "indistinguishable", seed, drawn.bench, drawn.hidden, "set", acceptable=drawn.alike)
    if drawn.channels == "temperature":
        for name in ("resistance_ohm", "meter_current_A"):
            made.columns.pop(name)
    follow_up = record(drawn.bench.rig.having(drawn.hidden), drawn.decisive, rng)
    return replace(made, follow_up=follow_up, holdout=None, details={"design": design or DESIGNS[seed % len(DESIGNS)]})


def disturbed_record(
    rng: Random,
    seed: int,
    disturbances: tuple[str, ...] = (),
    effect: str | None = None,
    clean: bool | None = None,
    rows: int | None = None,
) -> Case:
    """A record of one effect, every fourth of none, with outliers, gaps and the like."""
    without = seed % 4 == 3 if clean is None else clean
    kinds = tuple(disturbances)
    if not kinds:
        kinds = tuple(str(k) for k in rng.choice(DISTURBANCES, int(rng.integers(1, 4)), replace=False))
    if without:
        bench, hidden, shares = draw_bench(rng, rows=rows), {}, {}
    else:
        bench, hidden, shares = with_effects(rng, (effect or drawn_names(rng, 1)[0],), rows=rows)
    if "uneven" in kinds:
        bench = replace(bench, schedule=uneven(rng, bench.schedule))
    details = {"disturbances": kinds, "smallest_share": shares}
    made = finished(rng, "disturbed", seed, bench, hidden, "clean" if without else "exactly", details=details)
    return replace(made, columns=disturbed(rng, made.columns, kinds))


def at_the_limit(
    rng: Random, seed: int, effect: str = "radiative_loss", factor: float = 1.5, any_size: bool = False
) -> Case:
    """An effect at `factor` times the smallest that a test with the true model finds half of the time. any_size: also
    where that is far smaller than what one meets."""
    for _ in range(TRIES):
        bench = draw_bench(rng)
        rest = others(effect, rng, bench)
        if rest is None:
            continue
        if effect == "heat_sink_warmup":
            reference, low = {"sink_capacity_ratio": 3.0, "sink_conductance_ratio_per_s": 0.1}, 0.0
        else:
            low, high = bounds(effect, bench)
            reference = {SIZES[effect][0]: low if effect == "parallel_leakage" else high, **rest}
        oracle = Oracle(bench.rig, bench.schedule, recorded_current(bench, {}), cautious=False)
        share = smallest(effect, reference, oracle, made=slower)
        hidden = slower(effect, reference, share * factor)
        key = SIZES[effect][0] or "sink_capacity_ratio"
        size = hidden[key]
        if share * factor < 1.0 and (any_size or effect == "parallel_leakage" or size > NOT_TRIFLING * low):
            half = slower(effect, reference, share)[key]
            details = {"factor": factor, "effect": effect, "smallest": half}
            return finished(rng, "smallest", seed, bench, {effect: hidden}, "exactly", details=details)
    raise RuntimeError(f"no bench has {effect} at its limit within the sizes that one meets")


def negative(rng: Random, seed: int, control: str | None = None) -> Case:
    """No physical cause may be named with confidence; `control` chooses one of `controls.CONTROLS`."""
    control = control or tuple(CONTROLS)[seed % len(CONTROLS)]
    bench, effects, change = CONTROLS[control](rng)
    made = finished(rng, "negative", seed, bench, effects, "no_name", details={"control": control})
    columns = change(made.columns)
    holdout = change(made.holdout) if made.holdout is not None and control == "time_reversed" else made.holdout
    keep_holdout = control in ("time_reversed", "coarse_integrator")  # elsewhere it would tell
    return replace(made, columns=columns, holdout=holdout if keep_holdout else None)


def unlike(rng: Random, seed: int, manner: str | None = None, of: str = "one", effect: str | None = None) -> Case:
    """A record taken in another manner than the others, one of `UNLIKE`. of: "one" effect, "clean", "other_film"."""
    manner = manner or tuple(UNLIKE)[seed % len(UNLIKE)]
    taken = UNLIKE[manner]
    film = "of_class" if of != "other_film" else ("preisach", "forc")[int(rng.integers(0, 2))]
    bench, hidden, shares = draw_bench(rng, film, manner=taken), {}, {}
    if of == "one":
        bench, hidden, shares = with_effects(rng, (effect,) if effect else drawn_names(rng, 1), manner=taken)
    details = {"manner": manner, "of": of, "smallest_share": shares}
    made = finished(rng, "unlike", seed, bench, hidden, "exactly" if hidden else "clean", details=details)
    if not taken.told_current:
        del made.columns["meter_current_A"]
    return made


def real_noise(rng: Random, seed: int, of: str = "clean", effect: str | None = None, every: int = 1) -> Case:
    """Noise as real instruments have it. of: "clean" or "one" effect; every: thinned to every so many rows."""
    bench, hidden, shares = draw_bench(rng), {}, {}
    if of == "one":
        bench, hidden, shares = with_effects(rng, (effect,) if effect else drawn_names(rng, 1))
    rig = bench.rig.having(hidden)
    thermometer, meter = drawn_instruments(rng, rig.noise_K)
    columns = record_of(rig, bench.schedule, rng, thermometer, meter)
    return Case(
        kind="real_noise",
        seed=seed,
        columns={name: values[::every] for name, values in columns.items()},
        hidden=hidden,
        expectation="exactly" if hidden else "no_name",
        film=rig.film.name,
        noise={"temperature_K": thermometer.deviation_K, "correlation": meter.correlation},
        holdout=record_of(rig, bench.elsewhere, rng, thermometer, meter),
        details={"of": of, "every": every, "smallest_share": shares},
        bench=bench,
    )


def coloured_noise(
    rng: Random, seed: int, colour: str | None = None, effect: str | None = None, fault: str | None = None
) -> Case:
    """Noise of another colour than neighbouring rows that share a part; every other with an effect, or with a fault
    that has no name."""
    colour, hidden, details = colour or COLOURS[seed % len(COLOURS)], {}, {}
    if fault is not None:
        bench, value, _ = with_fault(rng, fault)
        bench = replace(bench, rig=replace(bench.rig, outside={fault: value}))
    elif effect is not None or seed % 2:
        bench, hidden, details["smallest_share"] = with_effects(rng, (effect,) if effect else drawn_names(rng, 1))
    else:
        bench = draw_bench(rng)
    rig = bench.rig.having(hidden)
    return Case(
        kind="coloured_noise",
        seed=seed,
        columns=coloured_record(rig, bench.schedule, rng, colour),
        hidden=hidden,
        expectation="unexplained" if fault is not None else "exactly" if hidden else "clean",
        film=rig.film.name,
        noise={"temperature_K": rig.noise_K, "resistance_dec": rig.noise_dec},
        holdout=coloured_record(rig, bench.elsewhere, rng, colour),
        details={"colour": colour, **details},
        bench=bench,
    )


PLANS: dict[str, Callable[..., Case]] = {
    "one": several("one", 1),
    "two": several("two", 2),
    "three": several("three", 3),
    "clean": clean,
    "other_film": other_film,
    "other_film_effect": other_film_effect,
    "further_film": further_film,
    "domains": domains,
    "outside": outside_the_catalogue,
    "indistinguishable": indistinguishable,
    "disturbed": disturbed_record,
    "smallest": at_the_limit,
    "negative": negative,
    "unlike": unlike,
    "real_noise": real_noise,
    "coloured_noise": coloured_noise,
}
