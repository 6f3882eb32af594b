"""The effects a picture can hold: one frozen description a file, with its size, its bound and its
cost.
"""
