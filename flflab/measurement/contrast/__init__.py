"""Contrast against frequency, from pictures of bars or of a chirp."""
