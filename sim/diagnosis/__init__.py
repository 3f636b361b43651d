"""What the simulation gets wrong, why, and what the repair gains."""
