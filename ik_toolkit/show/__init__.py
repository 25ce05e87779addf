"""Pictures of robots and results; imported by the command line, papers and notebooks, always lazily."""
