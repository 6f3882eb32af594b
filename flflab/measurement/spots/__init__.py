"""Images of round dots in many micro-images: where to look, found, and fitted by one law."""
