"""Reproduction of Shanmugasundar and Sivaramakrishnan (2012)."""
