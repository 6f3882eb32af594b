"""Whether a camera does what its model says: prediction, properties, judgement, suspects."""
