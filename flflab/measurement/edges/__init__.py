"""The transfer function from slanted edges."""
