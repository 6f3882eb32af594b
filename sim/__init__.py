"""Simulated instruments: places to connect to, all looking at one world."""
