"""A thread that outlives its tasks: what libraries cache a thread (fonts among it) would grow with a thread a task."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue


class Worker:
    """Does one task after the other. name: of its thread."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._renew()

    def begin(self, task: Callable[[], None]) -> threading.Event:
        """Do a task as soon as those before it are over; the event says when this one is, however it ended."""
        if not self._thread.is_alive():
            self._renew()
        over = threading.Event()
        self._tasks.put((task, over))
        return over

    def abandon(self) -> None:
        """Leave a task that does not end to itself; the next one gets a new thread."""
        self._renew()

    def _renew(self) -> None:
        self._tasks: SimpleQueue[tuple[Callable[[], None], threading.Event]] = SimpleQueue()
        self._thread = threading.Thread(target=_work, args=(self._tasks,), name=self._name, daemon=True)
        self._thread.start()


def _work(tasks: SimpleQueue[tuple[Callable[[], None], threading.Event]]) -> None:
    while True:
        task, over = tasks.get()
        try:
            task()
        finally:
            over.set()
        del task, over  # nothing of a task is held while the next one is waited for
