"""The fit of a film to records of temperature and output."""
