"""What is said besides names: intervals, confounders, what would not have shown, what to do next."""
