"""Fits of the chain's two ends to one record with given effects."""
