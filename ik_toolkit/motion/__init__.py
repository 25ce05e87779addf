"""Motions over time: references for a tip to track, their shapes and waypoints, and trajectories of the joints."""
