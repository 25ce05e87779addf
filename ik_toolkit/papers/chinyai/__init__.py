"""Chinyai, reproduced."""
