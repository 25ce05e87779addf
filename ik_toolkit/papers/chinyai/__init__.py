"""Reproduction of Chinyai's comparison of Newton-Raphson with a closed form."""
