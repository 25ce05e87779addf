"""Reproduction of Burrell et al. (2016)."""
