"""Which effects a record needs: both ends' fits by the names of their effects, and the steps from set to set."""
