"""Paths: from a sequence of poses to one joint motion, verified between the poses and timed."""
