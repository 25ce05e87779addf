"""`python -m ik_toolkit` runs the command `ik`."""

import sys

from .cli import main

sys.exit(main())
