"""Robots: reading, checking and writing descriptions, and the Pinocchio model of each."""
