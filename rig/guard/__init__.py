"""The guard: a parent process that switches the output off when the process that holds the ports dies.

`rig.guard.process.guarded(work)` forks; `rig.guard.pipe.Guard` is what the working process reports to.
"""
