"""What papers on such films report, from the readings alone: transition, widths, reversal curves."""
