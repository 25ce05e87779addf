"""How functions are compiled and cached on disk; this package knows numba and nothing of kinematics."""
