"""Motions over time: references for a tip to track, made of shapes or waypoints, and trajectories of the joints."""
