"""What a fit leaves: residuals, held-out rows and records, structure."""
