"""One model run four ways on the same nodes: by the simulated rig, the fits' forward model, `predict`, the observer.

Noise-free, before rounding, away from thresholds: rows 0.02 s apart, so that each way has its nodes at the rows; the
film has its operators where a fit has them, and a D(T) that the fit's splines carry exactly.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from rig.analysis.prediction import predicted
from rig.config.effect_tables import typical_value
from rig.config.model_file import Model
from rig.records.record import Record as RecordFile
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect, Switched, switched
from sim.inference.joint.films import PIFilm
from sim.inference.joint.likelihood import Joint
from sim.inference.joint.starts import first_metric
from sim.inference.record.record import Record, read_columns
from sim.model.chain import ChainModel
from sim.model.film_columns import SmoothCurve
from sim.model.observer import Observer
from sim.model.operator_outputs import radius_floor
from sim.model.record_own import FilmStart, RecordOwn
from sim.model.record_run import RecordRun
from sim.model.recorded import FINE
from sim.world.plant import SimulatedPlant, World

FIRST_DEGC, TEST_CURRENT_A = 57.0, 1e-4
PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
SHAPE = np.array([np.log(0.2), 62.0, np.log(0.2), 58.0])  # log a_R, c_R, log a_L, c_L
FRACTIONS = np.arange(6) / 6
WEIGHTS = np.array([0.35, 0.25, 0.15, 0.1, 0.08, 0.07])
D = (-5.0, 0.02, -1e-4, 1e-6)  # c_k v^k
FLOOR = radius_floor(SHAPE, 1.0)  # of tanh
FILM = FilmModel(
    FLOOR + (1.0 - FLOOR) * FRACTIONS,
    WEIGHTS,
    Envelope("tanh", 0.2, -0.2 * 62.0),
    Envelope("tanh", 0.2, -0.2 * 58.0),
    Memoryless("polynomial", coefficients=(0.0, *D[1:]), offset=D[0]),
)
TIME = np.arange(220) * 0.02
CURRENT = np.where(TIME < 0.5, 0.0, np.where(TIME < 2.4, 4.0, np.where(TIME < 3.7, -2.0, 2.0)))
SIZES = {  # away from thresholds, and multiples of the rows' distance
    "actuator_deadband": {"deadband_A": 0.3},
    "actuator_delay": {"delay_s": 0.4},
    "timestamp_skew": {"skew_s": 0.6},
    "meter_range_error": {"threshold_ohm": 1e3, "error": 0.01},
}


def on(effect: Effect) -> Switched:
    """An effect at the middle of the sizes met, or as in `SIZES`."""
    sizes = SIZES.get(effect.name, {})
    return switched(effect, {p.name: sizes.get(p.name, typical_value(p)) for p in effect.parameters})


def differences(effects: tuple[Switched, ...]) -> dict[str, tuple[float, float]]:
    """By way: the largest differences from the simulated rig, K and decades. The effects in the order given: it is the
    chain's to put them into its own."""
    unrounded = tuple(e for e in effects if not getattr(e.effect.form, "rounding", False))
    degC, output = by_the_rig(unrounded)
    ways = {
        "fit": by_the_fit(effects, TIME, CURRENT),
        "predict": by_predict(unrounded, TIME, CURRENT),
        "observer": by_the_observer(effects),
    }
    return {way: (_largest(T - degC), _largest(y - output)) for way, (T, y) in ways.items()}


def coarse_differences(effects: tuple[Switched, ...], every_s: float) -> tuple[float, float]:
    """RMS difference of the fit's own nodes from fine ones on rows so far apart, K and decades."""
    run = RecordRun(ChainModel(PLATE, FILM, effects), FINE)
    time = np.arange(0.0, 480.0 * every_s, every_s)
    current = 1.4 + 0.5 * np.sign(np.sin(time / 11.0)) + 0.5 * np.sin(time / 30.0)
    record = _record(time, current)
    plate = run.plate(record, _own())
    degC, output = by_the_fit(effects, time, current)
    left = output - run.shown(record, plate.path, _own())
    return float(np.sqrt(np.mean((degC - plate.shown_degC) ** 2))), float(np.sqrt(np.mean(left**2)))


def by_the_rig(effects: tuple[Switched, ...]) -> tuple[Array, Array]:
    """Event by event."""
    world = World(
        PLATE, FILM, FIRST_DEGC, thermometer_noise_K=0.0, ohmmeter_noise_dec=0.0, effects=effects, film_initial="cooled"
    )
    plant, shown = SimulatedPlant(world), []
    plant.set_test_current_A(TEST_CURRENT_A)
    for t, current in zip(TIME, CURRENT, strict=True):
        plant.advance_to(t)
        shown.append((plant.read_temperature_degC(), -np.log10(plant.read_resistance_ohm(TEST_CURRENT_A))))
        plant.set_current_A(current)
    return np.array(shown)[:, 0], np.array(shown)[:, 1]


def by_the_fit(effects: tuple[Switched, ...], time: Array, current: Array) -> tuple[Array, Array]:
    """Both channels of the fits' likelihood, with the true parameters."""
    curve, coefficients = the_fits_curve()
    film = PIFilm(curve, (62.0, 58.0), 0.2, (20.0, 110.0), FilmStart("cooled", (FIRST_DEGC,)))
    film = film.at_places(FRACTIONS)
    given = tuple(e for e in effects if not getattr(e.effect.form, "rounding", False))
    known = np.concatenate((coefficients, WEIGHTS))
    joint = Joint(_record(time, current), tuple(e.effect for e in given), film, "peltier", known)
    x = joint.start()
    plate = {"s": 1.6e-3, "r": 0.06, "g": 0.018, "ambient_degC": 25.0, "first_degC.0": FIRST_DEGC}
    for name, value in {**plate, "s_slope": 0.0, "r_slope": 0.0}.items():
        x[joint.place[name]] = value
    for e in given:
        x = joint.with_effect(x, e.effect, [float(v) for v in e.par])
    metric = first_metric(joint)
    at = joint.solve(x, metric)
    for _ in range(12):  # the ohmmeter's heat goes with the film's own resistance
        at = joint.solve(x, metric, at.own)
    return at.run.shown_degC, at.shown_dec


def by_predict(effects: tuple[Switched, ...], time: Array, current: Array) -> tuple[Array, Array]:
    """The model as a file has it, over a record as a file has it."""
    tables = tuple({"name": e.name, **e.values()} for e in effects)
    columns = {
        "time_s": time,
        "temperature_degC": np.full(time.size, FIRST_DEGC),
        "current_A": current,
        "meter_current_A": np.full(time.size, TEST_CURRENT_A),
    }
    found = predicted(Model(FILM, PLATE, tables), RecordFile(columns), "model", initial="cooled", drive="current")
    assert found.output is not None
    assert found.temperature_degC is not None
    return found.temperature_degC, found.output


def by_the_observer(effects: tuple[Switched, ...]) -> tuple[Array, Array]:
    """A period a row, nothing read."""
    observer, shown = Observer(ChainModel(PLATE, FILM, effects), float(TIME[1])), []
    state = observer.start(FIRST_DEGC, FILM.initial_memory(FIRST_DEGC, "cooled"), TEST_CURRENT_A)
    for current in CURRENT:
        shown.append((state.thermometer_degC, state.shown_output))
        state = observer.predicted(observer.sent(state, float(current)))
        state = observer.followed(state, state.plate_degC, state.thermometer_degC, TEST_CURRENT_A)
    return np.array(shown)[:, 0], np.array(shown)[:, 1]


@cache
def the_fits_curve() -> tuple[SmoothCurve, Array]:
    """The splines of the fit's D, and the coefficients of the constant and of D in them."""
    curve, places = SmoothCurve.over(20.0, 110.0), np.linspace(20.0, 110.0, 400)
    columns = np.column_stack((np.ones(400), curve.columns(places)))
    return curve, np.asarray(np.linalg.lstsq(columns, np.polyval(D[::-1], places), rcond=None)[0])


def every_effect() -> list[Effect]:
    """The catalogue, and one of a user's own if a test has made it known."""
    return list(catalogue().values())


def _record(time: Array, current: Array) -> Record:
    rng = np.random.default_rng(0)  # readings only have to be there: no fit looks at them
    return read_columns(
        {
            "time_s": time,
            "temperature_degC": FIRST_DEGC + 5.0 * rng.standard_normal(time.size),
            "current_A": current,
            "resistance_ohm": 10.0 ** (4.0 + rng.random(time.size)),
            "meter_current_A": np.full(time.size, TEST_CURRENT_A),
        },
        held_out=False,
    )


def _own() -> RecordOwn:
    return RecordOwn(25.0, np.array([FIRST_DEGC]), film=FilmStart("cooled", (FIRST_DEGC,)))


def _largest(difference: Array) -> float:
    return float(np.max(np.abs(difference)))
