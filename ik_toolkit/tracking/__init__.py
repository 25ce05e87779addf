"""Following a moving target: references, methods, stability, limits, runs."""
