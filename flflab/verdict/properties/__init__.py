"""The properties that are compared: how each is read from a run's frames and what the model says of
it, one property a file.
"""
