"""What the sensor adds to light: noise, gain, colour filters, darkness cut at 0."""
