"""Closed-form solvers, recognised from a chain's geometry."""
