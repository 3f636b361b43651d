"""Experiments without hardware: simulated, swept, replayed."""
