"""Run the command `ik` as `python -m ik_toolkit`."""

import sys

from .cli import main

sys.exit(main())
