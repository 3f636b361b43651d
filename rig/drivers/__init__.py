"""Drivers: one instrument a file, behind `controller.TemperatureController` and `meter.ResistanceMeter`."""
