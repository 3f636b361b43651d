"""What the user sets: configurations, model files, effects and targets, as checked TOML."""
