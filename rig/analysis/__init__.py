"""What is worked out from rows and models alone; it needs no bench."""
