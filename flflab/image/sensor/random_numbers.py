"""Random numbers of a frame or a sensor, row by row: those of a row depend on the key and on the
row alone, in whatever order and by however many threads rows are worked through.
"""

import hashlib

import numpy as np


def noise_key(*parts: object) -> int:
    """A key of 128 bits that depends on the representations of these parts and on nothing else."""
    text = "|".join(repr(part) for part in parts)
    digest = hashlib.blake2b(text.encode(), digest_size=16).digest()
    return int.from_bytes(digest, "little")


def generator(key: int, row: int, stream: int = 0) -> np.random.Generator:
    """The random numbers of a row: Philox under the key, its counter set by stream and row (Salmon,
    Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC11).
    """
    return np.random.Generator(np.random.Philox(key=key, counter=[0, stream, row, 0]))
