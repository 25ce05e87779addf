"""Solvers, and the calls that run them."""
