"""The paper's model: a frozen camera in, frozen results out."""
