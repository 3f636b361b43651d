"""Films that no play operator holds, to put the compensator to the test."""
