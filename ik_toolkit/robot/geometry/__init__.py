"""Shapes of links and obstacles, their distances and collisions."""
