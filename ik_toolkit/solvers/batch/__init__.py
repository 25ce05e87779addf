"""Solves many targets in one call."""
