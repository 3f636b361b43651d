"""What the bench measured, for months: SQLite with roll-ups, retention and an integrity check."""
