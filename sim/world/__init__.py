"""What is true of a simulated rig: films, the plant that instruments share, records in open loop."""
