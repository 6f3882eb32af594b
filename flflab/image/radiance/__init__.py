"""What a pixel or a ray's neighbourhood sees of a target, in closed forms over the target."""
