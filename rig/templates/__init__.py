"""Commented configurations that `peltier init` writes."""
