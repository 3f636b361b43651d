"""Touches the world: ports, clocks, files, people."""
