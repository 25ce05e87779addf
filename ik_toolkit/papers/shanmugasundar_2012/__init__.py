"""Shanmugasundar et al. 2012, reproduced."""
