"""Where cases are computed: processes of this computer, or a Dask cluster. It is chosen here and nowhere else.

Whoever has cases sees an `Engine`: something to submit to, as to a `concurrent.futures.Executor`, which can be begun
anew when a worker died, and to which a value that many cases need is given once. Source: Python library, chapter
concurrent.futures; Dask.distributed, `Client.get_executor`, `Client.submit`.
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
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from rig.core.extras import to_install
from rig.core.faults import fault
from rig.safety.signals import CAUGHT

ENGINES = ("processes", "dask")
KEPT = 8  # shared values that a worker keeps: a hold-out record and the records of the cases at hand
ON_THE_WAY = 2  # cases for each worker, each with a record of its own
DASK_WAIT_S = 20.0  # for a scheduler that is there: it answers in milliseconds, over a slow network in seconds


@dataclass(frozen=True)
class EngineChoice:
    """What the user chose. name: one of ENGINES; workers: processes, None: one a core; address: of a Dask scheduler,
    None: a cluster on this computer."""

    name: str = "processes"
    workers: int | None = None
    address: str | None = None

    def __post_init__(self) -> None:
        """Raises Faults."""
        if self.name not in ENGINES:
            raise fault("--engine", repr(self.name), f"expected {' or '.join(ENGINES)}")
        if self.workers is not None and self.workers < 1:
            raise fault("--workers", repr(self.workers), "expected a number >= 1")
        if self.address is not None and self.name != "dask":
            raise fault("--address", repr(self.address), "is of a Dask scheduler; expected --engine dask beside it")
        if self.address is not None and self.workers is not None:
            raise fault("--workers", repr(self.workers), "the scheduler at --address has its own; expected one of both")


class Engine(Protocol):
    """workers: how many cases are computed at once."""

    @property
    def workers(self) -> int: ...

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]: ...

    def share(self, value: Any) -> Any:
        """Something to submit in the place of a value that many cases need; `given` makes the value of it."""
        ...

    def begin_anew(self) -> None:
        """After a worker died: what was submitted and has not ended is gone. Raises Faults where nothing is left."""
        ...


@dataclass(frozen=True)
class Shared:
    """A value in a file of this computer, which is named by what is in it."""

    path: str


@dataclass(frozen=True, eq=False)
class OnCluster:
    """A value that a Dask cluster is to hold, and its name by what is in it."""

    key: str
    value: Any


def _itself(value: Any) -> Any:
    """In a worker."""
    return value


@lru_cache(maxsize=KEPT)
def _read(path: str) -> Any:
    return pickle.loads(Path(path).read_bytes())


def given(value: Any) -> Any:
    """In a worker: what was shared; it is read once. What was not shared is given back."""
    return _read(value.path) if isinstance(value, Shared) else value


@contextlib.contextmanager
def opened(choice: EngineChoice, at_most: int) -> Iterator[Engine]:
    """The engine, with no more workers than there are cases; with the context its cases end. Raises Faults."""
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
        """The pool's processes only: the caller's program may have others. Python has `kill_workers` from 3.14 on."""
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
    """In a worker: when the process that hands out the cases is killed, nobody would ever tell this one to end."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()


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


@contextlib.contextmanager
def _as_any_process() -> Iterator[None]:
    """A local cluster's workers keep freed memory, as any process does, and nobody samples their stack. Dask has glibc
    give back whatever is freed (MALLOC_TRIM_THRESHOLD_) and looks at the stack a hundred times a second, for hours of
    large results that these cases do not have: a diagnosis, which makes many short-lived arrays of 50 kB to 1 MB, took
    1.4 times the processor time. Its event loop looks at itself 50 times a second, each time taking the interpreter
    from the case (2 % of it); once a second does. Source: Dask.distributed, "Worker memory management", "automatically
    trim memory"; configuration reference, distributed.admin."""
    import dask.config

    environment = dict(dask.config.get("distributed.nanny.pre-spawn-environ"))
    environment.pop("MALLOC_TRIM_THRESHOLD_", None)
    settings = {
        "distributed.nanny.pre-spawn-environ": environment,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
    }
    with dask.config.set(settings):
        yield


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
                    with _as_any_process():
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
        """The value on the cluster, as what came out of a task: one that was scattered is gone for good with the worker
        that held it, and so are the cases that wait for it; a task is computed again."""
        if shared.key not in self._shared:
            self._shared[shared.key] = self._client.submit(_itself, shared.value, pure=False)
            while len(self._shared) > KEPT + ON_THE_WAY * self.workers:
                self._shared.popitem(last=False)
        self._shared.move_to_end(shared.key)
        return self._shared[shared.key]

    def begin_anew(self) -> None:
        """Dask replaces a worker by itself; a scheduler that is gone takes everything along."""
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
