"""Which configuration, and how well it must be built: search and tolerances over the model."""
