"""What can go wrong between this program and the instruments: one tree for all protocols.

    RigError
    |- PortHeld           another process holds the port (exit status 75)
    `- InstrumentError
       |- TimedOut        no complete answer within the deadline
       |- Corrupt         an answer came, and its checksum or form is wrong
       |- OutOfStep       an answer came, and it does not belong to this question
       |- Refused         the instrument understood, and said no; or read back something else than was set
       |- Disconnected    the port is gone
       `- Overrange       what was measured is beyond the range, where somebody insists on a number

Beyond the range is an outcome of measuring: readings come with a quality (`rig.core.reading.Quality.OVERRANGE`), and
become `Overrange` only by `Reading.number`. A value outside what may be commanded is a ValueError: the caller's fault,
raised before anything is sent.

| what the wire did         | MeCom                   | TE Technology       | SCPI, LDC501                     |
|---------------------------|-------------------------|---------------------|----------------------------------|
| nothing, half an answer   | TimedOut, 3 trials      | TimedOut            | TimedOut, or Refused (queue)     |
| wrong sum, CRC or form    | skipped, then Corrupt   | Corrupt             | Corrupt (two copies differ)      |
| late, repeated, foreign   | skipped (number)        | OutOfStep (fence)   | OutOfStep (token)                |
| the instrument says no    | Refused (error frame)   | Refused (read-back) | Refused (error queue, read-back) |
| unplugged                 | Disconnected            | Disconnected        | Disconnected                     |

After any of these the line is in doubt, and the next question brings it in step first.
"""

from __future__ import annotations


class RigError(Exception):
    """Anything the rig's hardware side reports."""


class PortHeld(RigError):
    """Another process holds the port.

    port: its name. pid, command: the holder's, None and "" where they cannot be found out.
    """

    exit_status = 75

    def __init__(self, port: str, pid: int | None = None, command: str = "") -> None:
        self.port, self.pid, self.command = port, pid, command
        holder = "another process" if pid is None else f"process {pid}" + (f" ({command})" if command else "")
        super().__init__(f"{port} is held by {holder}")


class InstrumentError(RigError):
    """An exchange with an instrument failed."""


class TimedOut(InstrumentError):
    """No complete answer within the deadline."""


class Corrupt(InstrumentError):
    """An answer with a wrong checksum or form."""


class OutOfStep(InstrumentError):
    """An answer that does not belong to this question."""


class Refused(InstrumentError):
    """The instrument said no. code: its own number, None where this program judged by reading back."""

    def __init__(self, code: int | None, meaning: str) -> None:
        self.code, self.meaning = code, meaning
        super().__init__(meaning if code is None else f"{meaning} (error {code})")


class Disconnected(InstrumentError):
    """The port is gone: unplugged, closed, or never there."""


class Overrange(InstrumentError):
    """A reading beyond the instrument's range, where a number was needed."""


def of_whom(error: InstrumentError, who: str) -> None:
    """Put the instrument in front of what is wrong with it, unless it stands there already. who: as `called` says."""
    if who and who not in str(error):
        error.args = (f"{who}: {error}",)


def called(port: str, role: str, driver: str) -> str:
    """Return the name of an instrument in messages. role: "controller" or "meter"; driver: as in the configuration."""
    return f"{port} ({role}, {driver})"
