"""The lattice of micro-images from a white picture, and which point of a target each pixel of it
looks at.
"""
