"""One way to compute many cases: on processes of this computer or a Dask cluster, with a journal of what is done.

A process that dies takes others' cases with it, and nobody knows whose case it was. So everything that was on its way
is then computed again, one case at a time: a process that dies now has died of its own case, or was killed from
outside, and the case is tried `TRIES` times before it is given up. Nothing else is lost or stops. Source: Python
library, chapter concurrent.futures; Dask.distributed, `Client.get_executor`, `Client.submit`.

    DIR/cases.jsonl    {"case": identity, "values": result, "seconds": duration} in the order of their ends
    DIR/NAME.csv       the table: a row a case, in the order of their numbers, the same bits whoever computed it
    DIR/NAME.nc        the same as NetCDF-3, which xarray opens
    DIR/times.csv      number, seconds

A process that is killed leaves at most its last line unfinished: it is no line, and its case is computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import multiprocessing
import multiprocessing.connection
import os
import pickle
import shutil
import signal
import tempfile
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.faults import fault
from rig.core.file_writing import naming_file, replacing
from rig.core.outcome import Stopped
from rig.core.requirements import to_install
from rig.records.record_file import write_columns
from rig.safety.signals import CAUGHT, SignalStop

LINES, TIMES = "cases.jsonl", "times.csv"
LOST = "lost"  # the status of a case whose process died: it is tried again when the command is given again
TABLE_EVERY_S = 5.0  # a table of 10,000 rows is written in a tenth of a second
Row = dict[str, Any]
Cell = str | float | int | list[str]  # of text lines: one of JSON's lists in the journal, one text in the table


def is_of_many(folder: Path | None) -> bool:
    """Return True if a folder has a journal of cases."""
    return folder is not None and (folder / LINES).is_file()


class Journal:
    """The results of cases in a folder. name: of the table. identities: by number, the columns that identify each case,
    its number first. others: number of earlier lines that are of none of these cases, and are left alone."""

    def __init__(self, folder: Path, name: str, identities: Mapping[int, Row], same: Sequence[str] = ()) -> None:
        """Continue the journal in a folder. same: the columns by which an earlier line is one of these cases, whatever
        its number; lines of other cases are then left alone if they have the same "of". Without it a line has to be the
        case of its number. Raises Faults for other lines, and if it cannot be read or written."""
        self._same, self.others = tuple(same), 0
        self._numbers = {self._key(identity): number for number, identity in identities.items()}
        self._of = {identity.get("of") for identity in identities.values()}
        self.folder, self._name, self.identities = folder, name, identities
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._path = folder / LINES
            self._lines = self._path.open("a", encoding="utf-8")
        except OSError as error:
            raise fault(folder, "", f"cannot be written: {error.strerror}") from None
        try:
            self._take_alone()
            self.done = self._read()
        except BaseException:
            self._lines.close()
            raise
        self._written_s = time.monotonic()

    def add(self, number: int, values: Mapping[str, Cell], seconds: float) -> None:
        """Add the result of a case."""
        self.done[number] = (dict(values), seconds)
        line = {"case": self.identities[number], "values": values, "seconds": round(seconds, 3)}
        with naming_file(self._path):
            self._lines.write(json.dumps(line) + "\n")
            self._lines.flush()
        if time.monotonic() - self._written_s > TABLE_EVERY_S:
            self.write_table()

    def note(self, number: int, values: Mapping[str, Cell]) -> None:
        """Add a case of which nothing can be computed as it is: a row of the table, and no line, so that it is tried
        when the command is given again."""
        self.done[number] = (dict(values), 0.0)

    def missing(self) -> list[int]:
        """Return the cases that are still to be computed: without a line, or lost with their process."""
        return [n for n in self.identities if n not in self.done or self.done[n][0].get("status") == LOST]

    def rows(self) -> list[Row]:
        """Return identity and result of each case, in the order of their numbers."""
        return [{**self.identities[number], **self.done[number][0]} for number in sorted(self.done)]

    def write_table(self) -> None:
        """Write the table as far as it is."""
        write_columns(self.folder / f"{self._name}.csv", table_columns(self.rows()))
        with replacing(self.folder / TIMES) as path:
            times = "".join(f"{number},{self.done[number][1]!r}\n" for number in sorted(self.done))
            path.write_text(f"number,seconds\n{times}", encoding="utf-8")
        self._written_s = time.monotonic()

    def close(self) -> None:
        """Write the table, also as NetCDF, and close the lines."""
        with naming_file(self._path):
            self._lines.close()
        self.write_table()
        with replacing(self.folder / f"{self._name}.nc") as path:
            write_netcdf(path, self.rows())

    def _take_alone(self) -> None:
        """Lock the lines until they are closed: whoever computed into the same folder meanwhile would compute all of it
        again, and cut off a line that is just being written. Raises Faults."""
        if os.name == "nt":
            return
        import fcntl

        try:
            fcntl.flock(self._lines, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            text = "another process is computing into it; wait for its end, or give another DIR"
            raise fault(self.folder, "", text) from None
        except OSError:  # a network's file system that locks nothing: nobody is kept out
            return

    def _read(self) -> dict[int, tuple[Row, float]]:
        """Read the finished lines; cut off an unfinished last one."""
        content = self._path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            os.truncate(self._path, len(whole))
        found = {}
        for k, line in enumerate(whole.decode("utf-8", "replace").splitlines(), 1):
            try:
                entry = json.loads(line)
                number, values, seconds = int(entry["case"]["number"]), dict(entry["values"]), float(entry["seconds"])
            except (ValueError, KeyError, TypeError):
                raise fault(self._path, f"line {k}", "is damaged; expected a line of a journal of cases") from None
            ours = self._number_of(number, entry["case"])
            if ours is None:
                self.others += 1
            else:
                found[ours] = (values, seconds)
        return found

    def _key(self, case: Row) -> tuple[Any, ...]:
        return tuple(case.get(name) for name in self._same)

    def _number_of(self, number: int, case: Row) -> int | None:
        """Return the number of a line's case now; None if it is none of these and may be left alone. Raises Faults."""
        if not self._same and self.identities.get(number) == case:
            return number
        if self._same and (not self._of or case.get("of") in self._of):
            return self._numbers.get(self._key(case))
        text = "is of other cases, of files with other contents, or of another version"
        raise fault(self._path, f"number {number}", f"{text}; expected the DIR of these, or a new one")


def files_of(name: str) -> list[str]:
    """Return the names of the files of a journal with a table `name`."""
    return [LINES, TIMES, f"{name}.csv", f"{name}.nc"]


def cases_in(folder: Path) -> list[Row]:
    """Return the identities of a journal's cases, in the order of its lines, without damaged ones."""
    try:
        lines = (folder / LINES).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found: list[Any] = []
    for line in lines:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            found.append(json.loads(line)["case"])
    return [case for case in found if isinstance(case, dict)]


def table_columns(rows: list[Row]) -> dict[str, list[Any]]:
    """Return the columns of rows, in the order in which they first occur; "" for a cell that a row does not have."""
    names = dict.fromkeys(name for row in rows for name in row)
    cells = {name: [row.get(name, "") for row in rows] for name in names}
    return {name: [" / ".join(c) if isinstance(c, list) else c for c in column] for name, column in cells.items()}


def write_netcdf(path: Path, rows: list[Row]) -> None:
    """Write rows as NetCDF-3: a dimension `case`, numbers as doubles, text as characters (which xarray joins)."""
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        setattr(file, "history", b"peltier-rig")  # noqa: B010 - an attribute of the file, not of the class
        file.createDimension("case", len(rows))
        for name, column in table_columns(rows).items():
            if all(value == "" or isinstance(value, (int, float)) for value in column):
                variable = file.createVariable(name, "f8", ("case",))
                variable[:] = np.array([math.nan if value == "" else float(value) for value in column])
                continue
            texts = [str(value).encode() for value in column]
            length = max(1, max((len(text) for text in texts), default=1))
            file.createDimension(f"{name}_length", length)
            characters = file.createVariable(name, "S1", ("case", f"{name}_length"))
            characters[:] = np.array([list(text.ljust(length, b"\0")) for text in texts], "u1").view("S1")


ENGINES = ("processes", "dask")
KEPT = 8  # shared values that a worker keeps: a hold-out record and the records of the cases at hand
ON_THE_WAY = 2  # cases for each worker, each with a record of its own
DASK_WAIT_S = 20.0  # for a scheduler that is there: it answers in milliseconds, over a slow network in seconds
TRIES = 3  # a case whose process died three times alone is what kills it, and not somebody's `kill`
WAITING = 2  # cases for each worker: one that runs, one that waits, so that no worker is idle while a result travels
LOOK_S = 1.0  # between two looks for a signal, which takes microseconds
DASK_LOST = ("KilledWorker", "CommClosedError", "FutureCancelledError")  # what Dask raises for cases whose process died


@dataclass(frozen=True)
class EngineChoice:
    """The user's choice. name: one of ENGINES; workers: processes, None: one a core; address: of a Dask scheduler,
    None: a cluster on this computer."""

    name: str = "processes"
    workers: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        """Raise Faults for a choice that cannot be."""
        if self.name not in ENGINES:
            raise fault("--engine", repr(self.name), f"expected {' or '.join(ENGINES)}")
        if self.workers is not None and self.workers < 1:
            raise fault("--workers", repr(self.workers), "expected a number >= 1")
        if self.address is not None and self.name != "dask":
            raise fault("--address", repr(self.address), "is of a Dask scheduler; expected --engine dask with it")
        if self.address is not None and self.workers is not None:
            raise fault("--workers", repr(self.workers), "the scheduler at --address has its own; expected one of both")


@dataclass(frozen=True)
class Shared:
    """A value in a file of this computer, named by a digest of its contents."""

    path: str


@dataclass(frozen=True, eq=False)
class OnCluster:
    """A value that a Dask cluster is to hold, named by a digest of its contents."""

    key: str
    value: Any


def _itself(value: Any) -> Any:
    """Return a value, in a worker."""
    return value


@lru_cache(maxsize=KEPT)
def _read(path: str) -> Any:
    return pickle.loads(Path(path).read_bytes())


def given(value: Any) -> Any:
    """Return, in a worker, a value that was shared, which is read once; what was not shared is returned as it is."""
    return _read(value.path) if isinstance(value, Shared) else value


class Processes:
    """Processes of this computer. workers: number of cases at a time."""

    def __init__(self, choice: EngineChoice, at_most: int) -> None:
        self.workers = max(1, min(choice.workers or os.cpu_count() or 1, at_most))
        self._pool: ProcessPoolExecutor | None = None
        self._folder = tempfile.mkdtemp(prefix="peltier-many-")

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        with _signals_for_us_alone():  # a process begins when there is work for it
            if self._pool is None:
                context = multiprocessing.get_context("spawn")  # compiled loops and signal handlers survive no fork
                self._pool = ProcessPoolExecutor(self.workers, context, _end_with_the_parent)
            return self._pool.submit(work, *arguments)

    def share(self, value: Any) -> Shared:
        """Return what to submit in place of a value that many cases need; `given` returns the value."""
        content = pickle.dumps(value)
        path = Path(self._folder) / hashlib.sha256(content).hexdigest()
        if not path.exists():
            path.write_bytes(content)
        return Shared(str(path))

    def begin_anew(self) -> None:
        """Go on after a worker died: what was submitted and has not ended is gone. Only the pool's processes are ended:
        the caller's program may have others. (Python 3.14 has `kill_workers`.)"""
        pool, self._pool = self._pool, None
        if pool is not None:
            workers = list((pool._processes or {}).values())  # before shutdown, which forgets them
            pool.shutdown(wait=False, cancel_futures=True)
            for process in workers:
                process.kill()

    def close(self) -> None:
        self.begin_anew()
        shutil.rmtree(self._folder, ignore_errors=True)


def _end_with_the_parent() -> None:
    """End this worker when the process that hands out the cases is killed: nobody else would."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()


@contextlib.contextmanager
def _signals_for_us_alone() -> Iterator[None]:
    """Leave signals to this process: Ctrl-C on a terminal reaches every process of the group."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, CAUGHT)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Dask:
    """A Dask cluster: the one at an address, or one on this computer for the time of the cases."""

    def __init__(self, choice: EngineChoice, at_most: int) -> None:
        try:
            import distributed
        except ImportError:
            raise fault("--engine", "'dask'", f"needs distributed: {to_install('cluster')}") from None
        self._distributed = distributed
        self._address = choice.address
        self._count = max(1, min(choice.workers or os.cpu_count() or 1, at_most))
        self._cluster: Any = None
        self._begin()

    def _begin(self) -> None:
        distributed = self._distributed
        try:
            with _signals_for_us_alone():
                if self._address is None:
                    self._cluster = distributed.LocalCluster(
                        n_workers=self._count, threads_per_worker=1, processes=True, dashboard_address=None
                    )
                self._client = distributed.Client(self._cluster or self._address, timeout=DASK_WAIT_S)
        except (OSError, ValueError, TypeError) as error:
            raise fault("--address", repr(self._address), f"no Dask scheduler answers there ({error})") from None
        self._executor = self._client.get_executor(pure=False)
        self._shared: OrderedDict[str, Any] = OrderedDict()

    @property
    def workers(self) -> int:
        return max(1, sum(self._client.nthreads().values())) if self._address is not None else self._count

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        there = [self._held(value) if isinstance(value, OnCluster) else value for value in arguments]
        future: Future[Any] = self._executor.submit(work, *there)
        return future

    def share(self, value: Any) -> OnCluster:
        return OnCluster(hashlib.sha256(pickle.dumps(value)).hexdigest(), value)

    def _held(self, shared: OnCluster) -> Any:
        """Return the value on the cluster, as the result of a task: one that was scattered is gone for good with the
        worker that held it, and so are the cases that wait for it; a task is computed again."""
        if shared.key not in self._shared:
            self._shared[shared.key] = self._client.submit(_itself, shared.value, pure=False)
            while len(self._shared) > KEPT + ON_THE_WAY * self.workers:
                self._shared.popitem(last=False)
        self._shared.move_to_end(shared.key)
        return self._shared[shared.key]

    def begin_anew(self) -> None:
        """Go on; Dask replaces a worker by itself, but a scheduler that is gone takes everything along."""
        self._shared.clear()
        if self._client.status == "running":
            return
        self.close()
        if self._address is not None:
            raise fault("--address", repr(self._address), "the Dask scheduler is gone; expected one that goes on")
        self._begin()

    def close(self) -> None:
        for part in (self._client, self._cluster):
            if part is not None:
                with contextlib.suppress(Exception):  # what is gone cannot be closed
                    part.close(timeout=2)
        self._cluster = None


Engine = Processes | Dask


@contextlib.contextmanager
def opened(choice: EngineChoice, at_most: int) -> Iterator[Engine]:
    """Open the engine, with no more workers than cases; its cases end with the context. Raises Faults."""
    engine = Dask(choice, at_most) if choice.name == "dask" else Processes(choice, at_most)
    try:
        yield engine
    finally:
        engine.close()


@dataclass(frozen=True)
class Case:
    """A computation, work(*arguments), in another process; both have to be such that they can be pickled."""

    number: int
    work: Callable[..., Any]
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Ended:
    """Result of a case. fault: "" or why there is no value; seconds: that it took where it ran."""

    number: int
    value: Any
    fault: str = ""
    seconds: float = 0.0


def each_ended(cases: Iterable[Case], engine: Engine) -> Iterator[Ended]:
    """Yield every case once, in the order in which they end; those that are found ended at once, in the order given.
    Only so many are submitted that no worker waits. Raises Faults if the engine is gone for good."""
    left = iter(cases)
    flying: dict[Future[Any], Case] = {}
    while True:
        lost = _submitted(islice(left, max(0, WAITING * engine.workers - len(flying))), engine, flying)
        if not flying and not lost:
            return
        ended = _some(flying) if flying and not lost else set()
        for future in [one for one in flying if one in ended]:  # a set's own order is another one in each process
            case = flying.pop(future)
            found = _result(case, future)
            if found is None:
                lost.append(case)
            else:
                yield found
        if lost:
            for future, case in flying.items():
                found = _result(case, future) if future.done() else None
                if found is None:
                    lost.append(case)
                else:
                    yield found
            flying.clear()
            engine.begin_anew()
            for case in sorted(lost, key=lambda case: case.number):
                yield _alone(case, engine)


def _some(flying: Iterable[Future[Any]]) -> set[Future[Any]]:
    """Return those that have ended, as soon as one has. It waits in pieces: the system may hand a signal to any thread,
    and Python raises what comes of it in the main one, which does not wake for it."""
    while not (ended := wait(flying, LOOK_S, FIRST_COMPLETED).done):
        pass
    return ended


def _submitted(cases: Iterable[Case], engine: Engine, flying: dict[Future[Any], Case]) -> list[Case]:
    """Submit cases; return those that a dead engine did not take."""
    lost = []
    for case in cases:
        try:
            flying[engine.submit(timed, case.work, *case.arguments)] = case
        except (BrokenExecutor, RuntimeError, OSError):
            lost.append(case)
    return lost


def _alone(case: Case, engine: Engine) -> Ended:
    """Compute a case while no other is computed."""
    for _ in range(TRIES):
        flying: dict[Future[Any], Case] = {}
        if not _submitted([case], engine, flying):
            found = _result(case, *_some(flying))
            if found is not None:
                return found
        engine.begin_anew()
    return Ended(case.number, None, f"the process that computed it died, {TRIES} times: killed, or out of memory?")


def _result(case: Case, future: Future[Any]) -> Ended | None:
    """Return the result of a case; None if its process died."""
    try:
        value, fault, seconds = future.result()
    except (BrokenExecutor, CancelledError):
        return None
    except Stopped:  # a signal that came while this was waiting: it comes once, and is nothing that the case came to
        raise
    except Exception as error:
        if type(error).__name__ in DASK_LOST:
            return None
        return Ended(case.number, None, f"could not be computed elsewhere ({type(error).__name__}: {error})")
    return Ended(case.number, value, fault, seconds)


def timed(work: Callable[..., Any], *arguments: Any) -> tuple[Any, str, float]:
    """Compute in a worker; return (value, fault, seconds). A case that fails in an unforeseen way fails alone."""
    began = time.perf_counter()
    try:
        value, fault = work(*arguments), ""
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        value, fault = None, f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})"
    return value, fault, time.perf_counter() - began


def compute(
    cases: Callable[[Engine], Iterable[Case]], count: int, choice: EngineChoice, take: Callable[[Ended], None]
) -> None:
    """Compute the cases that `cases` makes for the engine, `count` at most; take each as it ends. A signal ends them.
    Raises Faults, Stopped."""
    with SignalStop(), opened(choice, max(count, 1)) as engine:
        for ended in each_ended(cases(engine), engine):
            take(ended)


def compute_missing(
    journal: Journal,
    cases: Callable[[Engine, list[int]], Iterable[Case]],
    choice: EngineChoice,
    on_done: Callable[[int, int, dict[str, Any]], None],
) -> None:
    """Compute what the journal lacks, add it, and close it; cases(engine, numbers) makes the cases, whose values are
    rows; on_done(done, of, row) is called as each ends. Raises Faults, Stopped."""
    left = journal.missing()

    def take(ended: Ended) -> None:
        values = ended.value if not ended.fault else {"status": LOST, "text": ended.fault}
        journal.add(ended.number, values, ended.seconds)
        on_done(len(journal.done), len(journal.identities), {**journal.identities[ended.number], **values})

    try:
        compute(lambda engine: cases(engine, left), len(left), choice, take)
    finally:
        journal.close()
