"""The one context that ends with the controller's output off, whatever happens inside it.

A bench is inside one from the moment that its controller is open, and every run on it inside another: a run writes its
rows and its reason down with the output off already.
"""

from __future__ import annotations

from rig.config.tables import ControllerTable
from rig.core.errors import called
from rig.core.outcome import NotConfirmedOff, OfOutput
from rig.drivers.controller import TemperatureController
from rig.guard.pipe import UNGUARDED, Guard
from rig.ports.transport import nobody_answers
from rig.safety.signals import SignalStop
from rig.safety.switching_off import off_confirmed, switch_off


class OutputOff:
    """Context that ends with the controller's output off, whatever happens, and knows whether that is confirmed.

    table: where the controller is, for the error. signals: held back from the moment at which the output goes off, as
    long as an error is on its way; None: of the bench, whose output is commanded off at the beginning as well, and for
    whose output the guard answers until the end, or until everything has been tried and that is told.
    Raises NotConfirmedOff, which outranks all others; after it nothing is sent any more, which would only feed the
    controller's dead man.
    """

    def __init__(
        self,
        controller: TemperatureController,
        table: ControllerTable,
        guard: Guard = UNGUARDED,
        signals: SignalStop | None = None,
    ) -> None:
        self._controller, self._table = controller, table
        self._guard, self._signals = guard, signals
        self.confirmed: bool | None = None

    def __enter__(self) -> OutputOff:
        if self._signals is None:
            self._switch_off(None)
            self._guard.idle()  # where it had armed the output before, and lost it: that is over
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self._signals is not None:
            self._signals.shield()
        if isinstance(error, NotConfirmedOff):
            self.confirmed = False
            self._guard.given_up()
            return
        self._switch_off(error)
        if self._signals is None:
            self._guard.let_go()
            if error is not None:
                error.add_note(OfOutput(off_confirmed(self._controller)))
            return
        self._guard.idle()
        if error is None:
            self._signals.expose()

    def _switch_off(self, error: BaseException | None) -> None:
        """Raises NotConfirmedOff."""
        verdict = switch_off(self._controller, alive=self._guard.alive)
        self.confirmed = verdict.confirmed
        if not verdict.confirmed:
            self._guard.given_up()
            port, driver = self._table.port, self._table.driver
            who = called(port, "controller", driver)
            reason = f"; before that: {str(error).removeprefix(f'{who}: ')}" if error is not None else ""
            silent = nobody_answers(self._controller, port, "controller", driver, "to switch its output off")
            raise NotConfirmedOff(silent or f"{port}: {verdict.text}{reason}") from error
        if verdict.text and error is not None:
            error.add_note(verdict.text)
