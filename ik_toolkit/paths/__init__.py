"""Whole paths: from poses to one joint motion, proven between the poses, and in time."""
