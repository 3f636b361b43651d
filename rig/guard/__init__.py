"""The guard process: the parent of the process that holds the ports; it turns the output off when that one dies.

    guarded(work)      forks: the child does the work and tells what it holds, this process waits and watches
    Guard              what the working process tells its guard
    UNGUARDED          the same where there is none

Nothing here imports numpy or a configuration, so that the guard stays small: some 15 MB.
"""

from rig.guard.line import UNGUARDED, Guard, GuardGone
from rig.guard.process import guarded

__all__ = ["UNGUARDED", "Guard", "GuardGone", "guarded"]
