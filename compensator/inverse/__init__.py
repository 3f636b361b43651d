"""The temperature that gives a wanted output, from the present memory, and what a model lets one expect of it."""

from compensator.moved import names_of

__getattr__ = names_of("compensator.inverse.inverse")
