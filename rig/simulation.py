"""From the [simulation] table to the world that the simulated instruments share."""

from __future__ import annotations

from rig.files.configuration import ConfigurationFile, ModelFilmTable, RelayFilmTable
from rig.files.model_file import read_model
from sim.effects.effect import switched
from sim.effects.heat_sink_warmup import EFFECT as HEAT_SINK_WARMUP
from sim.films.preisach import PreisachFilm
from sim.plant import Film, World


def simulated_film(file: ConfigurationFile) -> tuple[Film, str]:
    """The true film, and the memory that it starts with."""
    table = file.content.simulation.film
    if isinstance(table, ModelFilmTable):
        model = read_model(file.beside(table.model), needs=("film",)).film
        assert model is not None
        return model, model.initial
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


def simulated_world(file: ConfigurationFile) -> World:
    """What is true of the simulated rig. Raises Faults where a model file is wrong."""
    table = file.content.simulation
    film, initial = simulated_film(file)
    sink = table.heat_sink_warmup
    return World(
        plate=table.plate.model(),
        film=film,
        first_degC=table.first_degC,
        film_initial=initial,
        thermometer_noise_K=table.thermometer_noise_K,
        ohmmeter_noise_dec=table.ohmmeter_noise_dec,
        seed=table.seed,
        effects=(switched(HEAT_SINK_WARMUP, sink.model_dump()),) if sink is not None else (),
    )
