"""The page a lab head signs: verdict, marked frames, curves, tables, bench and provenance in one
HTML file.
"""

from flflab.report.page import write_report

__all__ = ["write_report"]
