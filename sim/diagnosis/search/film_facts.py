"""What does not change between fits of the last links: where they begin, and the noise that they are weighed by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.likelihood import quick_noise
from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.path_error import PathError
from sim.diagnosis.data.record import Record, Rows
from sim.diagnosis.data.residual_outliers import outlying_rows
from sim.diagnosis.data.sparse_loop import SparseLoop, one_loop, sparse_loop
from sim.diagnosis.fit.channel_noise import ohmmeter_noise
from sim.diagnosis.fit.domain_noise import DomainNoise
from sim.diagnosis.fit.film_basis import ENVELOPES, FilmBasis
from sim.diagnosis.fit.film_memory import remembered
from sim.diagnosis.fit.film_prior import PriorWidths
from sim.diagnosis.fit.film_start import starting_shape, thinned_path
from sim.diagnosis.fit.one_loop import shifted_branches
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.inference.film.multistart import quartiles_of_change
from sim.model.film_nodes import film_nodes
from sim.model.links import Links
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart

LEAST_NOISE_DEC = 1e-5  # of a reading: six digits
MEMORY_ROUNDS = 3  # of memory and envelopes in turn: each moves the other less than before
QUIET = 0.25  # of the readings, whose noise is the instrument's own
BETTER_SQUARE = 0.97  # times the mean square, from which the second memory is the better one: chance changes it by less


def least_noise(noise: NoiseModel, output: Array) -> Array | float:
    """The least noise by which an outlier is told: as it is at such readings, where it is not the same at all."""
    return LEAST_NOISE_DEC if noise.plain else noise.marginal(np.nan_to_num(output))


@dataclass(frozen=True, eq=False)
class FilmFacts:
    """What does not change between fits of the last links: basis, first shape, memory at the first row, noise, how
    large the film's coefficients may be, whether its rows are too far apart for effects to be told from it, rows
    whose readings are outliers, and the domains that switch visibly, None: no such film."""

    basis: FilmBasis
    shape: Array
    start: FilmStart
    noise: NoiseModel
    prior: PriorWidths
    sparse: SparseLoop | None
    outliers: Rows
    domains: DomainNoise | None = None


def film_facts(
    record: Record, path: PlatePath, curve: bool, relays: bool = True, unsure: PathError | float | None = None
) -> FilmFacts:
    """A global search for the film's envelopes on thinned rows, for each memory it may have begun with. relays: whether
    it may be of another kind; unsure: as `Chain.unsure`."""
    assert record.output is not None
    fitted, output = ~record.held_out, np.nan_to_num(record.output)
    used = record.output_used & fitted
    best, shape, least = FilmStart("heated"), np.zeros(ENVELOPES), np.inf
    for start in (FilmStart("heated"), FilmStart("cooled")):
        thin = thinned_path(film_nodes(record, path, Links(), [], None, start), output, used, start)
        found, square = starting_shape(thin, curve)
        if square < BETTER_SQUARE * least:
            best, shape, least = start, found, square
    thin = thinned_path(film_nodes(record, path, Links(), [], None, best), output, used, best)
    noise = NoiseModel.white(max(quick_noise(output[used]), LEAST_NOISE_DEC))
    basis = FilmBasis.over(record, path, quartiles_of_change(thin), curve)
    channel = ResistanceChannel.of(record, path, fitted, noise, basis)
    fit = channel.descend(FilmParameters.of_the_class(shape, best))
    for _ in range(MEMORY_ROUNDS):  # the envelopes were found with another memory
        start = remembered(channel, fit.parameters)
        if start == fit.parameters.start:
            break
        fit = channel.descend(replace(fit.parameters, start=start))
    return _weighed(channel, fit, relays, unsure)


def _weighed(
    channel: ResistanceChannel, fit: ResistanceFit, relays: bool, unsure: PathError | float | None
) -> FilmFacts:
    """What the fit shows: the noise, outliers, and whether a single loop's branches are shifted copies."""
    record, output, used, p = channel.record, channel.output, channel.fitted, fit.parameters
    other = shifted_branches(channel, p, LEAST_NOISE_DEC) if relays and one_loop(record) else None
    shown = fit if other is None else other
    noise = ohmmeter_noise(channel, shown, LEAST_NOISE_DEC, unsure)
    quiet = float(np.quantile(noise.at(output[used]), QUIET))  # on a flank the film itself looks like noise
    outliers = outlying_rows(output, shown.shown, record.output_used, least_noise(noise, output))
    prior = PriorWidths() if other is None else other.parameters.prior
    return FilmFacts(channel.basis, p.x[:ENVELOPES], p.start, noise, prior, sparse_loop(record, quiet), outliers)
