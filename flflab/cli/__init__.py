"""The command line: names and JSON keys are a contract, see docs/commands.md. One file a
command.
"""

import sys

from flflab.cli.early_stop import ask_to_stop_early


def main() -> None:
    """Run one command; exit codes as ``flflab.cli.command.run``."""
    ask_to_stop_early(sys.argv[1:])
    from flflab.cli.command import run  # a stop waits for nothing

    run()
