"""Cameras, one file a protocol or vendor."""
