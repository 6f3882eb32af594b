"""Measurements made elsewhere: read from their files, and held against the model."""
