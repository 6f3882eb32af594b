"""One flat target's light where it is waves: the scalar image through every microlens's clipped
pupil.
"""
