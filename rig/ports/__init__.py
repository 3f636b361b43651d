"""Ports: opening them, carrying bytes with a deadline, simulated ones (`sim://NAME`), VISA's, and pseudo-terminals."""
