"""The control law: reference shaping, estimate, feedback, gains."""
