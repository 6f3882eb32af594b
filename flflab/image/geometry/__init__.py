"""What every micro-image looks at: its pupil, what cuts it, and where its rays end on a target."""
