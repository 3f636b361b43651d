"""What papers on such films report of a record: transition, widths, reversal curves, activation energy."""
