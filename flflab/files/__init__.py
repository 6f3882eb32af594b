"""Readers and writers of pictures, cameras and targets."""
