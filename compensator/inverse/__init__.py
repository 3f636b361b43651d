"""The temperature that gives a wanted output, from the present memory, and what a model lets one expect of it."""
