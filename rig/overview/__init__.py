"""One page for several bench daemons: a process of its own that holds their tokens, with a STOP for each."""
