"""Depth maps of focused light field pictures: distance with its uncertainty at every place, total
focus, refocus and point cloud; one method for Keplerian and Galilean cameras.
"""
