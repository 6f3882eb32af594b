"""The four dots: in which micro-images each is seen, and where in space that puts it."""
