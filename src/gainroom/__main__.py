"""python -m gainroom."""

import sys

from .cli import main

sys.exit(main())
