"""Blind tests of the diagnosis: an independent truth, cases from seeds, scores."""
