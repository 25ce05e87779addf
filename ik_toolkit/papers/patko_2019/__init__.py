"""Patko and Zelei 2019, reproduced."""
