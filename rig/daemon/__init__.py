"""The bench daemon: holds the instruments, queues and runs experiments, and answers requests about them."""
