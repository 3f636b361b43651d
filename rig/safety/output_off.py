"""The one context that ends with the controller's output off, whatever happens inside it."""

from __future__ import annotations

from rig.drivers.controller import TemperatureController
from rig.guard.line import UNGUARDED, Guard
from rig.outcome import NotConfirmedOff
from rig.safety.signals import SignalStop


class OutputOff:
    """Context that ends with the controller's output off, whatever happens, and knows whether that is confirmed."""

    def __init__(self, controller: TemperatureController, signals: SignalStop, guard: Guard = UNGUARDED) -> None:
        self._controller = controller
        self._signals = signals
        self._guard = guard
        self.confirmed: bool | None = None

    def __enter__(self) -> OutputOff:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._signals.shield()
        self.confirmed = self._controller.off()
        if not self.confirmed:
            reason = f" (after: {error})" if error is not None else ""
            raise NotConfirmedOff(f"the controller did not confirm that its output is off{reason}") from error
        self._guard.idle()
        if error is None:
            self._signals.expose()
