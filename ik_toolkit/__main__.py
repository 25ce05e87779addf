"""`python -m ik_toolkit` is the command `ik`."""

import sys

from .cli import main

sys.exit(main())
