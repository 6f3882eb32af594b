"""Image formation: from a scene down to one flat target's light, by rays or waves; one file an
effect; the sensor's response beside it.
"""
