"""Views and figures of robots and results; imported lazily by the command line, papers and notebooks."""
