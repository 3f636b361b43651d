"""What everything in `rig` stands on: clock, reading, the errors and the ways in which a command can end."""
