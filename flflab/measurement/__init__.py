"""Pictures measured: lattice of micro-images, dots, number of views, contrast; each result with its
uncertainty.
"""
