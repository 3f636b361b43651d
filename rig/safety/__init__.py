"""What keeps a bench safe, apart from every law: limits, credible readings, runaway, signals, the output off."""
