"""Kernels that sum a target's light over the pupil, one file for targets of a kind, and how finely
they do.
"""
