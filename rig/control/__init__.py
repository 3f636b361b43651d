"""The loop of fixed period, and what decides the current in it."""
