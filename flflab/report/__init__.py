"""The page a lab head signs: verdict, marked frames, curves, tables, bench and provenance in one
HTML file; and what a program reads of the verdict.
"""

from flflab.report.page import write_report
from flflab.report.verdict_file import junit_text, verdict_numbers, verdict_text

__all__ = ["junit_text", "verdict_numbers", "verdict_text", "write_report"]
