"""Many targets in one call."""
