"""For how many steps fits of the film go on."""

from typing import Final

QUICK_STEPS: Final = 4  # of a descent that is compared with others alike
WHOLE_STEPS: Final = 20  # of a fit that is compared with others, and has to have ended
RELAY_STEPS: Final = 6  # of a fit with relays, of which each costs a hundred of one without
