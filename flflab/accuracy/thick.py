"""Exact rays through spherical surfaces: real thick lenses, and what first order says of them.

Light runs along +z; a ray meets every surface where it is, is bent by Snell's law there, and
nothing is approximated. A ray that misses a surface or is totally reflected becomes nan. Lengths in
mm.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """Spherical surfaces in air, their centres on the z axis, the first vertex at z = 0.

    Attributes:
        curvature: of each surface, 1/mm, positive where its centre lies behind it; 0 for a plane.
        gap: from each surface's vertex to the next one's, mm; one fewer than surfaces.
        index: refractive index behind each surface, the last one 1.
        stop: number of the surface that is the stop; a plane between equal indices is no more than
            that.
    """

    curvature: tuple[float, ...]
    gap: tuple[float, ...]
    index: tuple[float, ...]
    stop: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no lens in air.

        Raises:
            InputError: the lists do not fit together, the last index is not 1, or the stop is none
                of the surfaces.
        """
        surfaces = len(self.curvature)
        if surfaces == 0 or len(self.gap) != surfaces - 1 or len(self.index) != surfaces:
            raise InputError(
                f"lens: {surfaces} curvatures, {len(self.gap)} gaps and {len(self.index)} indices;"
                " as many indices as curvatures and one gap fewer are due"
            )
        if self.index[-1] != 1:
            raise InputError(
                f"lens: the index behind the last surface is {self.index[-1]:g}; air, 1, is due"
            )
        if not 0 <= self.stop < surfaces:
            raise InputError(
                f"lens: the stop is surface {self.stop}; 0 to {surfaces - 1} are there"
            )

    @property
    def vertex(self) -> Array:
        """Place of each vertex along the axis, mm; shape (surfaces,)."""
        return np.concatenate([[0.0], np.cumsum(self.gap)])


@dataclass(frozen=True)
class FirstOrder:
    """What first order says of a lens; places in mm behind the first vertex.

    Attributes:
        focal_length: effective focal length, mm.
        front: front principal plane.
        rear: rear principal plane.
        stop_share: height in the stop of a ray parallel to the axis over its height before the
            lens.
        exit_pupil: place of the stop's image seen from behind; infinite where the lens is
            telecentric there.
        pupil_share: diameter of the exit pupil over that of the entrance pupil.
    """

    focal_length: float
    front: float
    rear: float
    stop_share: float
    exit_pupil: float
    pupil_share: float


def mirrored(lens: Lens) -> Lens:
    """The same lens seen by light that comes from behind."""
    return Lens(
        tuple(-c for c in reversed(lens.curvature)),
        tuple(reversed(lens.gap)),
        (*reversed(lens.index[:-1]), 1.0),
        len(lens.curvature) - 1 - lens.stop,
    )


def scaled(lens: Lens, focal_length: float) -> Lens:
    """The same lens, larger or smaller, with this effective focal length in mm."""
    factor = focal_length / first_order(lens).focal_length
    return replace(
        lens,
        curvature=tuple(c / factor for c in lens.curvature),
        gap=tuple(g * factor for g in lens.gap),
    )


def trace(lens: Lens, position: Array, direction: Array) -> tuple[Array, Array]:
    """Trace rays through every surface.

    Args:
        lens: the lens.
        position: any point on each ray before the lens, (x, y, z) mm, shape (..., 3).
        direction: its direction, of length 1, z above 0, shape (..., 3).

    Returns:
        Where each surface is met, shape (surfaces, ..., 3), and the direction behind the lens,
        shape (..., 3).

    Source: vector form of Snell's law, e.g. Welford, Aberrations of Optical Systems, section 4.3.
    """
    met: list[Array] = []
    before = 1.0
    for curvature, vertex, behind in zip(lens.curvature, lens.vertex, lens.index, strict=True):
        local = position - np.array([0.0, 0.0, vertex])
        along = direction[..., 2] - curvature * np.sum(local * direction, axis=-1)
        height = curvature * np.sum(local * local, axis=-1) - 2 * local[..., 2]
        with np.errstate(invalid="ignore"):
            step = height / (along + np.sqrt(along**2 - curvature * height))
            local = local + step[..., None] * direction
            normal = np.array([0.0, 0.0, 1.0]) - curvature * local
            cosine = np.sum(direction * normal, axis=-1)
            ratio = before / behind
            bent = np.sqrt(1 - ratio**2 * (1 - cosine**2))
        direction = ratio * direction + (bent - ratio * cosine)[..., None] * normal
        position = local + np.array([0.0, 0.0, vertex])
        met.append(position)
        before = behind
    return np.stack(met), direction


def at_plane(position: Array, direction: Array, z: npt.ArrayLike) -> Array:
    """(x, y) where rays meet the plane at ``z`` mm, shape (..., 2)."""
    step = (np.asarray(z, dtype=float) - position[..., 2]) / direction[..., 2]
    return position[..., :2] + step[..., None] * direction[..., :2]


def first_order(lens: Lens) -> FirstOrder:
    """Focal length, principal planes and pupils from the paraxial ray transfer matrices of the
    surfaces.

    Raises:
        InputError: the lens is afocal.
    """
    heights, slope = _paraxial(lens, 1.0, 0.0, 0)
    if slope == 0:
        raise InputError("lens: it is afocal; a lens with a focal length is due")
    focal = -1 / slope
    back, back_slope = _paraxial(mirrored(lens), 1.0, 0.0, 0)
    last = float(lens.vertex[-1])
    pupil_height, pupil_slope = _paraxial(lens, 0.0, 1.0, lens.stop)
    edge_height, edge_slope = _paraxial(lens, 1.0, 0.0, lens.stop)
    to_pupil = -pupil_height[-1] / pupil_slope if pupil_slope != 0 else np.inf
    pupil_size = edge_height[-1] + edge_slope * to_pupil
    return FirstOrder(
        focal_length=focal,
        front=(back[-1] - 1) / back_slope,
        rear=last + (1 - heights[-1]) / slope,
        stop_share=heights[lens.stop],
        exit_pupil=last + to_pupil,
        pupil_share=pupil_size * heights[lens.stop],
    )


def _paraxial(lens: Lens, height: float, slope: float, first: int) -> tuple[list[float], float]:
    """Heights at the surfaces and the last slope of a paraxial ray that starts before surface
    ``first``, the earlier ones left out.

    Where it starts at the stop, that surface is taken as already passed: rays are followed from
    behind it.
    """
    before = 1.0 if first == 0 else lens.index[first - 1]
    heights: list[float] = []
    for number in range(first, len(lens.curvature)):
        if number > first:
            height += lens.gap[number - 1] * slope
        behind = lens.index[number]
        slope = (before * slope - (behind - before) * lens.curvature[number] * height) / behind
        before = behind
        heights.append(height)
    return heights, slope
