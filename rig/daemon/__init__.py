"""The bench daemon: owns the instruments, queues and runs experiments, tells others what happens."""
