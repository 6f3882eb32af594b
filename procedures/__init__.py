"""Bluesky plans, one a file, each readable as the lab instruction."""
