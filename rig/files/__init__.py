"""Files that people and other programs read and write: configurations, models, records, targets, run folders."""
