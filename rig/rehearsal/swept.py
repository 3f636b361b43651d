"""Many simulated experiments, in several processes: every combination of a [sweep] table, one row of a table each."""

from __future__ import annotations

import contextlib
import copy
import csv
import itertools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core.errors import RigError
from rig.core.faults import Faults, fault
from rig.core.outcome import Outcome
from rig.files.configuration import SweepTable
from rig.files.effect_tables import add_effect_files, effect_in_words, switched_effects
from rig.files.record_file import write_columns
from rig.files.toml_file import checked
from rig.files.toml_text import read_toml
from rig.rehearsal.simulated import simulate, simulated_configuration, table_in, target_error
from rig.safety.signals import CAUGHT, SignalStop

RESULTS = ("status", "rows", "rms_dec", "max_dec", "rms_K", "max_K", "text")


@dataclass(frozen=True)
class Point:
    """One experiment: its number, the keys that are set, effects in words, the noise's seed."""

    number: int
    parameters: dict[str, Any]
    effects: tuple[str, ...]
    seed: int

    def table(self) -> dict[str, str]:
        """Its columns, as they stand in the file."""
        columns = {"number": str(self.number), **{key: str(value) for key, value in self.parameters.items()}}
        return {**columns, "effects": " ".join(self.effects), "seed": str(self.seed)}


def points_of(table: SweepTable) -> Iterator[Point]:
    """Every value with every other."""
    seeds = list(range(table.seeds)) if isinstance(table.seeds, int) else table.seeds
    values = itertools.product(*table.parameters.values())
    for number, (chosen, effects, seed) in enumerate(itertools.product(values, table.effects, seeds)):
        yield Point(number, dict(zip(table.parameters, chosen, strict=True)), tuple(effects), seed)


def sweep(
    path: Path, out: Path, workers: int | None, records: bool, tell: Callable[[int, int, str], None]
) -> list[dict[str, str]]:
    """The table's rows, in the order of their numbers. Raises Faults before anything is begun."""
    raw = read_toml(path)
    if "sweep" not in raw:
        raise fault(path, "sweep", "missing; expected a table [sweep] with seeds, effects, parameters")
    if workers is not None and workers < 1:
        raise fault("--workers", repr(workers), "expected a number >= 1")
    table = checked(SweepTable, raw["sweep"], path)
    points = list(points_of(table))
    _check(path, raw, points)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise fault(out, "--out", f"cannot be made: {error.strerror}") from None
    file = out / "sweep.csv"
    names = [*points[0].table(), *RESULTS]
    done = {int(row["number"]): row for row in _read(file, names, points)}
    left = [point for point in points if point.number not in done]
    if not file.exists():
        file.write_text(",".join(f'"{name}"' for name in names) + "\n", encoding="utf-8")
    count = min(workers or os.cpu_count() or 1, max(len(left), 1))
    context = multiprocessing.get_context("spawn")  # compiled loops and signal handlers do not survive a fork
    with SignalStop(), contextlib.ExitStack() as stack:
        with _signals_for_us_alone():
            pool = stack.enter_context(ProcessPoolExecutor(count, context))
            stack.enter_context(_ended_with(pool))
            jobs = [pool.submit(experiment, path, point, out if records else None) for point in left]
        lines = stack.enter_context(file.open("a", encoding="utf-8", newline=""))
        writer = csv.DictWriter(lines, names, lineterminator="\n", restval="")
        for job in as_completed(jobs):
            row = job.result()
            writer.writerow(row)
            lines.flush()
            done[int(row["number"])] = {name: str(row.get(name, "")) for name in names}
            tell(len(done), len(points), " ".join(f"{key}={value}" for key, value in row.items() if value != ""))
    return [done[number] for number in sorted(done)]


@contextlib.contextmanager
def _ended_with(pool: ProcessPoolExecutor) -> Iterator[None]:
    """Whatever goes wrong, Ctrl-C too, ends the experiments that run and those that wait; their rows are not there."""
    try:
        yield
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.kill()
        raise


@contextlib.contextmanager
def _signals_for_us_alone() -> Iterator[None]:
    """Ctrl-C on a terminal reaches every process of the group: those that begin here leave it to this one."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, CAUGHT)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def experiment(path: Path, point: Point, records: Path | None) -> dict[str, str]:
    """One row: what was varied and what came out of it; what goes wrong is a row too."""
    row = point.table()
    try:
        file = simulated_configuration(path, *_varied(path, read_toml(path), point))
        simulated = simulate(file, lambda text: None, None)
    except (Faults, Outcome, RigError) as error:
        return {**row, "status": "failed", "text": str(error)}
    if records is not None:
        write_columns(records / f"record_{point.number:05d}.csv", simulated.columns)
    ended = simulated.ended
    row |= {"status": "done" if ended is None else "tripped", "text": "" if ended is None else str(ended)}
    row["rows"] = str(simulated.rows)
    return {**row, **{name: repr(value) for name, value in target_error(simulated).items()}}


def _varied(path: Path, raw: dict[str, Any], point: Point) -> tuple[dict[str, Any], list[dict[str, Any]], int]:
    """What TOML would have made of the configuration with the point's values; its effects; its seed."""
    raw = copy.deepcopy(raw)
    files = table_in(raw, "simulation").get("effect_files", [])
    add_effect_files(path.parent / name for name in (files if isinstance(files, list) else []) if isinstance(name, str))
    for key, value in point.parameters.items():
        *tables, last = key.split(".")
        inner = raw
        for name in tables:
            inner = table_in(inner, name)
        inner[last] = value
    return raw, [effect_in_words(text) for text in point.effects], point.seed


def _check(path: Path, raw: dict[str, Any], points: list[Point]) -> None:
    """Every value and every effect once, before hours are spent. Raises Faults."""
    if not points:
        raise fault(path, "sweep", "nothing to do: expected at least one value of each")
    seen: set[str] = set()
    for point in points:
        fresh = [t for t in (str(point.parameters), str(point.effects)) if t not in seen]
        if not fresh:
            continue
        seen.update(fresh)
        varied, tables, seed = _varied(path, raw, point)
        lines = switched_effects(tables, f"{path}: sweep.effects", complete=False)[1]
        if lines:
            raise Faults(lines)
        simulated_configuration(path, varied, tables, seed)


def _read(file: Path, names: list[str], points: list[Point]) -> list[dict[str, str]]:
    """The rows that are there already. Raises Faults where they are of another sweep."""
    if not file.exists():
        return []
    with file.open(encoding="utf-8", newline="") as lines:
        rows = [row for row in csv.DictReader(lines) if row.get("status")]
    known = {point.number: point.table() for point in points}
    for row in rows:
        wanted = known.get(int(row["number"]), {})
        if set(row) != set(names) or any(row[name] != value for name, value in wanted.items()) or not wanted:
            raise fault(
                file, f"number {row['number']}", "is of another sweep; expected --out of this one, or a new DIR"
            )
    return rows
