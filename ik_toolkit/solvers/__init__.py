"""Solvers: what finds a q for a target, and the calls that run them."""
