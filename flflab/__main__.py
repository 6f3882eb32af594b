"""For ``python -P -m flflab``, the same as the console script ``flflab``."""

import sys

from flflab.cli import main

sys.exit(main())
