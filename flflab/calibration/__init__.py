"""Fits of the model to measurements: L and b from parallax, and a whole bench from white and dot
pictures.
"""
