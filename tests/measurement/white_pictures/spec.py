"""What a white picture of a microlens array is drawn from, and the truth that goes with it."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt
from white_pictures.profiles import Profile, SoftDisc

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Layout = Literal["square", "hexagonal along x", "hexagonal along y"]


@dataclass(frozen=True)
class Readout:
    """The sensor.

    Attributes:
        white: Light of 1 in DN above the black level.
        electrons: Light of 1 in electrons; 0 leaves all noise out.
        read_noise: Electrons.
        black: DN.
        bits: Of a number; full scale is ``2^bits - 1``.
        gamma: Numbers are full scale times ``linear^(1/gamma)``.
        saturated: Share of the pixels at full scale; where above 0, ``white`` is what gives it.
        pixel_gain: Relative scatter of the pixels' gains.
        column_gain: Relative scatter of the columns' gains.
        column_offset: Scatter of the columns' offsets, DN.
        second_tap: Gain of the right half against the left, less 1.
        warm: Share of warm pixels; each adds up to a tenth of full scale.
        shading: Light in the corners as a share of the middle's, pixel by pixel.
    """

    white: float = 40000.0
    electrons: float = 10000.0
    read_noise: float = 5.0
    black: float = 500.0
    bits: int = 16
    gamma: float = 1.0
    saturated: float = 0.0
    pixel_gain: float = 0.0
    column_gain: float = 0.0
    column_offset: float = 0.0
    second_tap: float = 0.0
    warm: float = 0.0
    shading: float = 1.0


@dataclass(frozen=True)
class WhiteSpec:
    """A white picture; by default an ideal one.

    Distances over the field are measured from ``axis`` in units of the farthest corner's.

    Attributes:
        shape: Rows and columns of the picture.
        layout: Square, or hexagonal with its dense rows along x or along y (before ``angle``).
        pitch: Of micro-images, px: the root of a square cell's area, 2^0.5 / 3^0.25 times the root
            of a hexagonal one's.
        angle: By which the array is turned, degrees, from x to y.
        origin: A lattice point, px, as a displacement from the picture's middle.
        stretch: Cells are longer along x than along y by this share, areas kept.
        shear: Symmetric shear of the cells, rad.
        profile: Shape of a micro-image.
        aspect: Micro-images are longer along ``aspect_angle`` by this share, areas kept.
        aspect_angle: degrees.
        kinds: Radius of each kind in nominal ones; one, two ((i + j) mod 2) or three
            ((i - j) mod 3) of them.
        scatter: Of the lenses' places about the lattice, px in each direction.
        brightness: Relative scatter of the lenses' light.
        corner: Light of a corner's lens as a share of the middle's.
        falloff_power: Of the distance, in the light's fall.
        slope: Change of light from side to side of a micro-image as a share, the same all over.
        slope_angle: degrees.
        slope_at_corner: The same change along the radius, growing linearly to the corner.
        rounding: Share of the light that is lost from the centre to the radius at half light.
        second_stop: Aspect of the cats' eyes in the corner, 1 for none; their short axis is radial
            and their aspect grows as the distance squared.
        halo: Share of the light that goes into the halo.
        halo_length: Of the halo's exponential, px; half of its light has three times this.
        blur: Standard deviation of a blur of the whole picture, px.
        bend: Distance of the lattice from the best straight one, px rms, cubic in the distance.
        axis: Middle of the field, px, as a displacement from the picture's middle.
        dead: Number of lenses with 2 to 22 % of their light.
        half_covered: Number of lenses of which one half is dark.
        missing: Number of lenses that are not there.
        margin: Unlit surrounds: no lens has its centre nearer than this to the picture's edge, px.
        readout: The sensor.
    """

    shape: tuple[int, int] = (600, 800)
    layout: Layout = "square"
    pitch: float = 30.0
    angle: float = 0.0
    origin: tuple[float, float] = (0.0, 0.0)
    stretch: float = 0.0
    shear: float = 0.0
    profile: Profile = field(default_factory=lambda: SoftDisc(12.0, 1.0))
    aspect: float = 0.0
    aspect_angle: float = 0.0
    kinds: tuple[float, ...] = (1.0,)
    scatter: float = 0.0
    brightness: float = 0.0
    corner: float = 1.0
    falloff_power: float = 2.0
    slope: float = 0.0
    slope_angle: float = 0.0
    slope_at_corner: float = 0.0
    rounding: float = 0.0
    second_stop: float = 1.0
    halo: float = 0.0
    halo_length: float = 10.0
    blur: float = 0.0
    bend: float = 0.0
    axis: tuple[float, float] = (0.0, 0.0)
    dead: int = 0
    half_covered: int = 0
    missing: int = 0
    margin: float = -math.inf
    readout: Readout = field(default_factory=Readout)

    @property
    def symmetry(self) -> float:
        """Turns by this angle leave the lattice as it is, degrees."""
        return 90.0 if self.layout == "square" else 60.0


@dataclass(frozen=True)
class TrueLattice:
    """A straight lattice.

    Attributes:
        vectors: Its two vectors as columns, px.
        origin: Where index (0, 0) lies, (x, y) px.
        pitch: px, as ``WhiteSpec.pitch`` defines it.
        angle: Rotation of the polar decomposition, degrees, within half a symmetry of 0.
        symmetry: 90 or 60 degrees.
    """

    vectors: Array
    origin: Array
    pitch: float
    angle: float
    symmetry: float

    def at(self, indices: npt.NDArray[np.int64]) -> Array:
        """Lattice points of these indices, (N, 2) px."""
        return self.origin + indices @ self.vectors.T


@dataclass(frozen=True)
class Truth:
    """What was drawn: an entry for each lens whose micro-image reaches the picture.

    Attributes:
        lattice: Least-squares straight lattice through the whole lenses before they scatter.
        index: (N, 2).
        centre: Centre of the disc, (N, 2) px; slope, rounding and brightness do not move it.
        light: At the centre, without the neighbours' and the halo's.
        missing: Lenses that are not there.
        whole: Lenses whose micro-image is all there, dead and half-covered ones left out.
    """

    lattice: TrueLattice
    index: npt.NDArray[np.int64]
    centre: Array
    light: Array
    missing: Flags
    whole: Flags
