"""Burrell et al. 2016, reproduced."""
