"""What `import rig` offers: thin fronts to the rooms that the command line's verbs call, returning values.

Errors are the project's own: `Faults` for what the user gave, a line for each fault; `RigError` for instruments.
"""
