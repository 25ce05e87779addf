"""How kernels are compiled and kept on disk; knows numba and nothing of kinematics."""
