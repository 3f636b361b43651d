"""The chain from the current to both readings: one model, used stepped, over a record, and as an observer."""
