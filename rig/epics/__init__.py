"""An EPICS server beside the bench daemon: a process of its own, fed by the daemon's socket and by nothing else."""
