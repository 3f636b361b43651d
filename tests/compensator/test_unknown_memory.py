"""A film whose memory nobody knows: the readings tell it, without going where the target does not."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from compensator.control.estimator import possible_memories
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import PidGains
from compensator.hysteresis.film import Memory
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import TEN_OPERATORS as FILM

PLATE = PlateModel(1.67e-3, 0.067, 0.0167, 25.0)
PERIOD_S, NOISE_K, NOISE_DEC = 0.1, 0.01, 0.002
LOW_DEGC, HIGH_DEGC = 10.0, 95.0


def left(turns_degC: list[float]) -> Memory:
    """The memory after these turning points, from the hot end."""
    path = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(turns_degC)])
    return FILM.simulate(path, FILM.initial_memory(turns_degC[0], "cooled"))[1]


def test_every_possible_memory_shows_the_reading() -> None:
    memory = left([90.0, 56.0, 63.0, 59.0])
    output = FILM.output_at(memory)
    rows = possible_memories(FILM, 59.0, output, LOW_DEGC, HIGH_DEGC)
    assert rows.shape[0] > 100
    for row in rows:
        assert FILM.output_at(Memory(59.0, row[:10])) + row[10] == pytest.approx(output, abs=1e-6)
        assert abs(row[10]) < 0.021
    assert np.std(rows[:, 4]) > 0.01  # and they are not all the same
    assert np.array_equal(rows, possible_memories(FILM, 59.0, output, LOW_DEGC, HIGH_DEGC))


def test_no_memory_explains_a_reading_far_off_the_loop() -> None:
    law = full()
    assert possible_memories(FILM, 59.0, -2.0, LOW_DEGC, HIGH_DEGC).shape[0] == 0
    assert law.start_anywhere(59.0, -2.0).possible.shape[0] == 0


def full() -> Law:
    return Law(LawSettings("full", PERIOD_S, 4.0, LOW_DEGC, HIGH_DEGC, PidGains(1.2, 0.3, 1.0)), PLATE, FILM)


def followed(memory: Memory, targets: Array, estimated: bool) -> tuple[Array, Memory, Memory]:
    """The film's own error, its memory and the law's, after a course from that memory."""
    law, chance, degC, errors = full(), np.random.default_rng(3), memory.input_degC, []
    ahead, state = np.round(law.preview_times_s() / PERIOD_S).astype(int), None
    for k in range(targets.size):
        output, memory = FILM.step(degC, memory)
        reading, read = degC + NOISE_K * chance.standard_normal(), output + NOISE_DEC * chance.standard_normal()
        if state is None:
            state = law.start_anywhere(reading, read) if estimated else law.start(reading, None)
        coming = targets[np.minimum(k + ahead, targets.size - 1)]
        command, state = law.step(state, Inputs(reading, read, float(targets[k]), coming))
        degC = PLATE.step(degC, command.current_A, PERIOD_S)
        errors.append(output - targets[k])
    assert state is not None
    return np.array(errors), memory, state.memory


def test_a_wrong_first_memory_corrects_itself_on_the_way() -> None:
    memory = left([90.0, 30.0, 62.5, 58.5])  # from the cold end: the model's default is from the hot one
    first = FILM.output_at(memory)
    course = np.interp(
        np.arange(0.0, 160.0, PERIOD_S), [0, 5, 45, 60, 110, 160], first + np.array([0, 0, 0.4, 0.4, -0.1, 0.3])
    )
    estimated, truth, found = followed(memory, course, estimated=True)
    assumed, _, wrong = followed(memory, course, estimated=False)
    assert np.sqrt(np.mean(estimated**2)) < 0.6 * np.sqrt(np.mean(assumed**2))
    weights = FILM.weights
    assert weights @ np.abs(found.plays - truth.plays) < 0.5 * (weights @ np.abs(wrong.plays - truth.plays)) + 0.02


def test_a_step_with_possible_memories_changes_nothing_of_its_state() -> None:
    law, memory = full(), left([90.0, 56.0, 63.0, 59.0])
    output = FILM.output_at(memory)
    state = law.start_anywhere(59.0, output)
    before = state.possible.copy()
    inputs = Inputs(59.0, output, output, np.full(law.preview_times_s().size, output + 0.1))
    first, again = law.step(state, inputs), law.step(state, inputs)
    assert first[0] == again[0]
    assert np.array_equal(first[1].possible, again[1].possible)
    assert np.array_equal(state.possible, before)
    with pytest.raises(ValueError, match="read-only"):
        first[1].possible[0, 0] = 1.0
