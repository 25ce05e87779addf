"""Explains how a solution comes about: what `Result.explain()` returns."""
