"""One likelihood for the whole chain: how records are fitted."""
