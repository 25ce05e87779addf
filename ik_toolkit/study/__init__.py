"""Many solves and their statistics: benchmark, tuning, workspace."""
