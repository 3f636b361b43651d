"""From selected effects to names that may be said."""
