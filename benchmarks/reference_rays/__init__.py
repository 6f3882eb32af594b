"""The slow reference by another path: rays refracted one by one and summed along straight lines."""
