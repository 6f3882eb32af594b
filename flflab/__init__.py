"""Focused light field camera: its model, pictures, their measurement, and the comparison of the two."""
