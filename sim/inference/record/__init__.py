"""A record as the likelihood takes it: columns checked, output of the film, gaps, which readings count."""
