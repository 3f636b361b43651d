"""A record as a diagnosis takes it: its rows, what is left out of them, and how likely its readings are."""
