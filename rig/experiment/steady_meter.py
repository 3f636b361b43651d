"""One test current over a target, where the ohmmeter heats the film.

An ohmmeter changes its test current with its range, by ten at a time, and a film that it heats by theta I^2 R jumps: by
0.3 K within a reading, at 3000 K/W, 0.1 mA and 10 kohm. The plate takes a tenth of a second and more to follow, and a
film that jumps back has to cross its loop. So where the model knows of self-heating, the current with which all that is
wanted can be read is kept. Resistances outside the target, on the way to it, may take a smaller one.
"""

from __future__ import annotations

import math

import numpy as np

from rig.analysis.predicted import needs_test_current
from rig.config.configuration import Configuration
from rig.config.model_file import Model
from rig.config.target import Target
from rig.control.loop import Loop
from rig.drivers.meter import LOG_RESISTANCE, ResistanceMeter

BEYOND = 1.1  # of the target's ends: a film off by 0.04 decades still finds its range


def largest_test_current_A(
    meter: ResistanceMeter | None, configuration: Configuration, model: Model, target: Target
) -> float:
    """The largest test current that a run on this target may have, A.

    That of the configuration for a film that the meter does not heat, and where no current is enough for all of it; a
    meter of one's own that cannot tell keeps its ranges.
    """
    most_A = configuration.limits.meter_current_A
    steady = getattr(meter, "steady_test_current_A", None)
    if steady is None or target.quantity != "resistance" or not needs_test_current(model.switched()):
        return most_A
    ohms = 10.0**-target.values
    current_A = float(steady(float(np.min(ohms)) / BEYOND, float(np.max(ohms)) * BEYOND, most_A))
    return most_A if math.isnan(current_A) else current_A


def allow_test_current(loop: Loop, configuration: Configuration, most_A: float) -> None:
    """The meter's ranges for this run, where they are other ones than the run before had. Raises RigError."""
    meter, table = loop.bench.meter, configuration.bench.meter
    if meter is None or table is None or meter.output != LOG_RESISTANCE:
        return
    if getattr(meter, "most_test_current_A", most_A) == most_A:
        return
    meter.configure(table.four_wire, table.nplc, most_A)
    loop.folder.event(loop.elapsed_s(), "test_current", f"at most {most_A:g} A")
