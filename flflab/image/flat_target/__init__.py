"""One flat target's light on the sensor: by the kernels that suit it, still or moving."""
