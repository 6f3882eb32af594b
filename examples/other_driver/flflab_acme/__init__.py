"""Linear stages of a maker that does not exist."""
