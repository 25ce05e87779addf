"""Descriptions of robots: URDF, xacro, SRDF, MJCF and Denavit-Hartenberg tables."""
