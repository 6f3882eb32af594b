"""Instruments of a bench, each behind the same few promises."""
