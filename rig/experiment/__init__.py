"""Experiments: what is done with a bench, and what comes out of it."""
