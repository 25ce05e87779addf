"""The compiled core: flat arrays in, numbers out. Knows neither Pinocchio nor URDF."""
