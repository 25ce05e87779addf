"""One step at a time: the joint motion to command now, whatever the target does."""
