"""For ``python -P -m flflab``, the same as the console script ``flflab``."""

from flflab.cli import main

main()
