"""One way to compute many cases: on processes of this computer, or on a Dask cluster.

`compute` takes cases from their engine to their end. An `Engine` is something to submit to, as to a
`concurrent.futures.Executor`, which can be begun anew when a worker died, and to which a value that many cases need is
given once. A process that dies takes others' cases with it, and nobody knows whose case it was. So everything that
was on its way is then computed again, one case at a time: a process that dies now has died of its own case, or was
killed from outside, and the case is tried `TRIES` times before it is given up. Nothing else is lost or stops. Source:
Python library, chapter concurrent.futures; Dask.distributed, `Client.get_executor`, `Client.submit`.
"""

from __future__ import annotations

import contextlib
import hashlib
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
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

from rig.batch.journal import LOST, Journal
from rig.core.faults import fault
from rig.core.outcome import Stopped
from rig.core.requirements import to_install
from rig.safety.signals import CAUGHT, SignalStop

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


class Engine(Protocol):
    """Where cases are computed. workers: number of cases at a time."""

    @property
    def workers(self) -> int: ...

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]: ...

    def share(self, value: Any) -> Any:
        """Return what to submit in place of a value that many cases need; `given` returns the value."""
        ...

    def begin_anew(self) -> None:
        """Go on after a worker died: what was submitted and has not ended is gone. Raises Faults if nothing is left."""
        ...


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


@contextlib.contextmanager
def opened(choice: EngineChoice, at_most: int) -> Iterator[Engine]:
    """Open the engine, with no more workers than cases; its cases end with the context. Raises Faults."""
    engine: _Processes | _Dask
    if choice.name == "dask":
        engine = _Dask(choice, at_most)
    else:
        engine = _Processes(max(1, min(choice.workers or os.cpu_count() or 1, at_most)))
    try:
        yield engine
    finally:
        engine.close()


class _Processes:
    """Processes of this computer."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._folder = tempfile.mkdtemp(prefix="peltier-many-")

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        with _signals_for_us_alone():  # a process begins when there is work for it
            if self._pool is None:
                context = multiprocessing.get_context("spawn")  # compiled loops and signal handlers survive no fork
                self._pool = ProcessPoolExecutor(self.workers, context, _end_with_the_parent)
            return self._pool.submit(work, *arguments)

    def share(self, value: Any) -> Shared:
        content = pickle.dumps(value)
        path = Path(self._folder) / hashlib.sha256(content).hexdigest()
        if not path.exists():
            path.write_bytes(content)
        return Shared(str(path))

    def begin_anew(self) -> None:
        self._end()

    def _end(self) -> None:
        """End the pool's processes only: the caller's program may have others. (Python 3.14 has `kill_workers`.)"""
        pool, self._pool = self._pool, None
        if pool is not None:
            workers = list((pool._processes or {}).values())  # before shutdown, which forgets them
            pool.shutdown(wait=False, cancel_futures=True)
            for process in workers:
                process.kill()

    def close(self) -> None:
        self._end()
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


class _Dask:
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
        on_done(len(journal.done), journal.count, {**journal.case(ended.number), **values})

    try:
        compute(lambda engine: cases(engine, left), len(left), choice, take)
    finally:
        journal.close()
