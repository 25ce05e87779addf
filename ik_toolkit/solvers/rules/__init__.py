"""Rules: one step of an iterative method each. A rule reads error and Jacobian and writes dq; the loop does the rest."""
