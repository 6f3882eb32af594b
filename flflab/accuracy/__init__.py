"""What accuracy costs in time, and where the first-order model holds: ``flflab accuracy
image|model``.
"""
