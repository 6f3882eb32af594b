"""From light to numbers: exposure, the sensor's response, its noise row by row, and the raw
picture.
"""
