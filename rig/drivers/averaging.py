"""A meter's own filter: a reading that is the mean of several integrations, one after the other ("repeat").

Sources: Model 2000 User's Manual rev J chapter 5, 2400 series manual chapter 18, Model 2450 reference manual section 6,
SENSe subsystem, AVERage. A repeating filter fills its stack anew for every reading, so that no reading has a share of
the one before. The mean of k has the noise of one over the root of k, and takes k times as long.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from math import isnan, nan
from typing import Any

from rig.core.errors import Corrupt, Refused
from rig.drivers.scpi import ScpiLink


@dataclass(frozen=True)
class Averaging:
    """count: integrations of a reading. each_s: from the beginning of one to that of the next, as it was measured (s);
    nan: it is not known, and taken for the integration alone."""

    count: int = 1
    each_s: float = nan

    def middle_s(self, aperture_s: float) -> float:
        """From the beginning of the first integration, of aperture_s, to the middle of all, s."""
        each_s = aperture_s if isnan(self.each_s) else max(self.each_s, aperture_s)
        return 0.5 * (aperture_s + (self.count - 1) * each_s)

    def apply(self, link: ScpiLink, header: str) -> None:
        """Set the filter whose header that is, and read it back. Refused where that is something else: the filter is
        switched off then, as far as the meter obeys."""
        if self.count == 1:
            link.command(f"{header}:STAT OFF")
            answers, expected = link.answers(f"{header}:STAT?", 1), ["0"]
        else:
            link.command(f"{header}:TCON REP;{header}:COUN {self.count};{header}:STAT ON")
            answers = link.answers(f"{header}:TCON?;{header}:COUN?;{header}:STAT?", 3)
            expected = ["REP", f"{self.count}", "1"]
        answers = [answer.strip().lstrip("+").upper() for answer in answers]
        try:
            numbers = [f"{float(answer):.0f}" for answer in answers[1:]]
        except ValueError:
            link.doubt()
            raise Corrupt(f"{answers} is not how a filter is set") from None
        if not answers[0].startswith(expected[0]) or numbers != expected[1:]:
            if self.count > 1:
                with suppress(Refused):
                    Averaging().apply(link, header)
            raise Refused(None, f"the meter's filter reads back {answers}, {expected} is expected")


def average(meter: Any, averaging: Averaging) -> None:
    """Every reading of the meter is from now on such a mean. Raises Refused where it has no filter; InstrumentError."""
    own = getattr(meter, "average", None)
    if own is None:
        raise Refused(None, "the meter does not average its readings itself")
    own(averaging)
