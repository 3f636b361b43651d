"""What can go wrong with a link of the signal chain, an effect a file."""
