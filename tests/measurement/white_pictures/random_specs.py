"""White pictures drawn at random, several imperfections at once, as large as real ones."""

import math
from collections.abc import Callable

import numpy as np
from white_pictures.profiles import Blob, OverlappingDiscs, Profile, SoftDisc
from white_pictures.spec import Layout, Readout, WhiteSpec

_LAYOUTS: tuple[Layout, ...] = ("square", "hexagonal along x", "hexagonal along y")


def random_spec(rng: np.random.Generator, hardness: float = 1.0) -> WhiteSpec:
    """A white picture of 400 to 1500 px, pitch 8 to 120 px, at least six micro-images across.

    Args:
        rng: Where the picture is drawn from.
        hardness: 0 for none but noise, 1 for imperfections of the sizes of real pictures.
    """
    rows, columns = (int(n) for n in np.exp(rng.uniform(math.log(400), math.log(1500), 2)))
    largest = min(120.0, min(rows, columns) / 6.5)
    pitch = float(np.exp(rng.uniform(math.log(8), math.log(largest))))
    profile = _profile(pitch, rng)
    layout = _LAYOUTS[rng.integers(3)]
    spots = isinstance(profile, Blob)
    lenses = rows * columns / pitch**2

    def size(largest: float, share: float = 0.6) -> float:
        """An imperfection: in this share of the pictures, up to this size."""
        return float(rng.uniform(0, largest) * hardness) if rng.random() < share else 0.0

    def number(share: float) -> int:
        """A few lenses, at least one where there are any."""
        return math.ceil(size(share, 0.4) * lenses) if lenses > 60 else 0

    return WhiteSpec(
        shape=(rows, columns),
        layout=layout,
        pitch=pitch,
        angle=float(rng.uniform(-45, 45) if rng.random() < 0.3 else rng.normal(0, 1)),
        origin=(float(rng.uniform(-pitch, pitch)), float(rng.uniform(-pitch, pitch))),
        stretch=size(1e-3) * _sign(rng),
        shear=size(1e-3) * _sign(rng),
        profile=profile,
        aspect=size(0.07),
        aspect_angle=float(rng.uniform(0, 180)),
        scatter=size(min(0.1, 0.005 * pitch)),
        brightness=size(0.018),
        corner=1 - size(0.6),
        falloff_power=float(rng.uniform(1.5, 4)),
        slope=0.0 if spots else size(0.1),
        slope_angle=float(rng.uniform(-180, 180)),
        slope_at_corner=0.0 if spots else size(0.07),
        rounding=0.0 if spots else size(0.4),
        second_stop=1 + (0.0 if spots else size(0.2, 0.4)),
        halo=size(0.08),
        halo_length=float(rng.uniform(6, 15)),
        blur=size(0.8, 0.3),
        kinds=_kinds(layout, size(0.03, 0.25), rng),
        bend=size(min(0.4, 0.015 * pitch)),
        axis=(float(rng.normal(0, columns / 10)), float(rng.normal(0, rows / 10))),
        dead=number(0.004),
        half_covered=number(0.004),
        missing=number(0.002),
        margin=pitch * float(rng.uniform(0.5, 2)) if lenses > 150 and rng.random() < 0.15 else 0.0,
        readout=_readout(rng, size),
    )


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _kinds(layout: Layout, size: float, rng: np.random.Generator) -> tuple[float, ...]:
    """Radii of three kinds of a hexagonal array, of two of a square one."""
    count = 2 if layout == "square" else 3
    return tuple(1 + size * rng.uniform(-1, 1, count)) if size else (1.0,)


def _profile(pitch: float, rng: np.random.Generator) -> Profile:
    """Gaps, touching or a little overlap; spots in every fifth picture."""
    radius = pitch * float(rng.uniform(0.32, 0.53))
    kind = rng.random()
    if kind < 0.2:
        return Blob(max(1.3, pitch * float(rng.uniform(0.17, 0.28))), float(rng.uniform(2, 3)))
    if kind < 0.5:
        rim = max(2.0, radius * float(rng.uniform(0.05, 0.35)))
        return OverlappingDiscs(radius, rim)
    return SoftDisc(radius, max(0.5, min(3.0, radius * float(rng.uniform(0.03, 0.2)))))


def _readout(rng: np.random.Generator, size: Callable[[float], float]) -> Readout:
    """A camera of 8, 12 or 16 bits; micro-images that overlap do not saturate it."""
    bits = int(rng.choice([8, 12, 16], p=[0.2, 0.4, 0.4]))
    full = 2**bits - 1
    return Readout(
        white=full * float(rng.uniform(0.25, 0.45)),
        electrons=float(np.exp(rng.uniform(math.log(2000), math.log(30000)))),
        read_noise=float(rng.uniform(2, 10)),
        black=full * float(rng.uniform(0.01, 0.04)),
        bits=bits,
        pixel_gain=size(0.005),
        column_gain=size(0.002),
        column_offset=size(5e-4) * full,
        second_tap=size(0.003),
        warm=size(1e-4),
    )
