"""Tests of parts of the kernel, which only plain Python can call: `test_parts_of_the_kernel` runs this folder uncompiled."""

from numba import config

if not config.DISABLE_JIT:
    collect_ignore_glob = ["test_*.py"]
