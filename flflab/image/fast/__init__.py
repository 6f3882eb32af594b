"""Closed forms for one flat target whose maps leave it upright."""
