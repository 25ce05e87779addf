"""Whole paths: from poses to one joint motion, verified between the poses and timed."""
