"""What is asked over time: references, shapes, waypoints, trajectories."""
