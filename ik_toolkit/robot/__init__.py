"""Robots: reading, checking and writing their descriptions, and the Pinocchio model behind each."""
