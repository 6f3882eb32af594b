"""Sentences for the operator: shown as they are, whatever the terminal's encoding."""

import io
import sys

from flflab.printable import printable


def say(sentence: str) -> None:
    """Write a line on standard error; what devices and files said in it is shown, not obeyed."""
    sys.stderr.write(f"{printable(sentence)}\n")


def replace_what_the_terminal_lacks() -> None:
    """Let standard output write ``?`` for characters that its encoding lacks, as one of Windows in
    Japanese lacks some, instead of ending the command.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
