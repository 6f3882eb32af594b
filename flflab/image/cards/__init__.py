"""Targets seen past the edges of cards that stand before them, where rays do not all fare alike."""
