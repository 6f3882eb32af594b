"""Image formation: one file an effect, and the sensor's response."""
