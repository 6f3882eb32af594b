"""From light to numbers: exposure, the sensor's response, its noise by counter, and the raw
picture.
"""
