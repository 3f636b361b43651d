"""Parameters of film and plate from records, with their standard errors."""
