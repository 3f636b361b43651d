"""Hysteresis model, its inverse, identification, plate and control law: arrays and frozen dataclasses in and out.

No clock, no port, no file and no log is known here; time is a parameter.
"""
