"""Records of measurements: read from tables of many formats, checked, and written by a run."""
