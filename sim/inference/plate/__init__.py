"""The fit of a plate to records of temperature and current."""
