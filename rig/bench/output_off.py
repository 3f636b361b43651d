"""The one context that ends with the controller's output off, whatever happens inside it."""

from __future__ import annotations

from rig.core.outcome import NotConfirmedOff
from rig.drivers.controller import TemperatureController
from rig.guard.line import UNGUARDED, Guard
from rig.safety.signals import SignalStop
from rig.safety.switching_off import switch_off


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
        verdict = switch_off(self._controller, alive=self._guard.alive)
        self.confirmed = verdict.confirmed
        if not verdict.confirmed:
            self._guard.given_up()
            reason = f" (after: {error})" if error is not None else ""
            raise NotConfirmedOff(f"{verdict.text}{reason}") from error
        self._guard.idle()
        if error is None:
            self._signals.expose()
        elif verdict.text:
            error.add_note(verdict.text)
