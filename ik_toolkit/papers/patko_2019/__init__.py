"""Reproduction of Patko and Zelei (2019)."""
