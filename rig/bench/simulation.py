"""From the [simulation] table to the world that the simulated instruments share.

Effects are those of [[simulation.effects]], of [simulation.heat_sink_warmup], and of the model that is the film.
"""

from __future__ import annotations

from rig.config.configuration import ConfigurationFile
from rig.config.effect_tables import switch_effects
from rig.config.model_file import read_model
from rig.config.tables import ModelFilmTable, RelayFilmTable
from rig.core.faults import fault
from rig.records.film_output import in_decades
from sim.effects.effect import Switched, switched
from sim.effects.heat_sink_warmup import EFFECT as HEAT_SINK_WARMUP
from sim.model.film_side import Film
from sim.model.links import links_of
from sim.world.films import PreisachFilm, film_of_world
from sim.world.world import Detector, World


def simulated_film(file: ConfigurationFile) -> tuple[Film, str]:
    """Return the true film, and the memory that it starts with."""
    table = file.content.simulation.film
    if isinstance(table, ModelFilmTable):
        model = read_model(file.beside(table.model), needs=("film",)).film
        assert model is not None
        meter = file.content.bench.meter
        if meter is not None and meter.quantity == "resistance" and not in_decades(model.output):
            text = f"its film's output is {model.output!r}; expected a resistance to be read in ohms, or a meter"
            raise fault(file.path, "simulation.film.model", f"{text} with quantity = 'voltage'")
        return film_of_world(model), model.initial
    assert isinstance(table, RelayFilmTable)
    film = PreisachFilm.bell_shaped(
        table.seed,
        table.relays,
        table.mean_degC,
        table.spread_K,
        table.halfwidth_K,
        table.halfwidth_sigma,
        table.decades,
        table.memoryless.memoryless(),
    )
    return film, "cooled"


def simulated_effects(file: ConfigurationFile) -> tuple[Switched, ...]:
    """Return the effects that are switched on. Raises Faults, as for an effect that two places switch on."""
    table = file.content.simulation
    effects, _ = switch_effects(table.effects, "simulation.effects", complete=False)
    if table.heat_sink_warmup is not None:
        effects += (switched(HEAT_SINK_WARMUP, table.heat_sink_warmup.model_dump()),)
    if isinstance(table.film, ModelFilmTable):
        effects += read_model(file.beside(table.film.model)).switched()
    return effects


def simulated_world(file: ConfigurationFile) -> World:
    """Return what is true of the simulated rig. Raises Faults if a model file is wrong."""
    table = file.content.simulation
    film, initial = simulated_film(file)
    effects = simulated_effects(file)
    try:
        links_of(effects)
    except ValueError as error:
        raise fault(file.path, "simulation.effects", f"{error}, with those of simulation.film's model") from None
    return World(
        plate=table.plate.model(),
        film=film,
        first_degC=table.first_degC,
        film_initial=initial,
        thermometer_noise_K=table.thermometer_noise_K,
        ohmmeter_noise_dec=table.ohmmeter_noise_dec,
        seed=table.seed,
        effects=effects,
        detector=Detector(**table.detector.model_dump()) if table.detector is not None else None,
    )
