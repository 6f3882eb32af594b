"""Dots seen by microlenses of several kinds, each with a rim and a blur of its own, are found where
the target stands.
"""

import numpy as np
import numpy.typing as npt
import pytest

from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.dots.views import count_views
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.sensor.noise import SensorNoise
from flflab.optics.camera import Camera, MainLens, MicrolensArray, Sensor, Useful
from flflab.targets import FourDot, Target, White

Array = npt.NDArray[np.float64]
NOISE = SensorNoise(
    dn_per_electron=0.34125, read_noise_dn=1.02375, offset_dn=64.0, full_scale_dn=4095.0
)
SIMILAR = (  # kinds blurred by 0.3, 1.2 and 0.9 px
    Camera(
        MainLens(65.647, 5.3833),
        MicrolensArray(
            "hexagonal", (13, 15), (0.18267, 0.18267), 0.16061, (0.6854, 0.6952, 0.6726), 80.7888,
            ((0, 1, 2), (2, 0, 1)),
            tilt=(-0.0007, 0.0005),
        ),
        Sensor((400, 441), 0.00305, 81.6073),
        useful=Useful(0.5),
    ),
    FourDot(0.9, 3.1646),
    455.4,
)  # fmt: skip
UNLIKE = (  # kinds blurred by 0.2, 0.8 and 1.5 px: one as broadly as few points to a pixel do for
    Camera(
        MainLens(40.217, 4.712),
        MicrolensArray(
            "hexagonal", (11, 13), (0.14301, 0.14301), 0.12706, (0.58792, 0.60023, 0.58003),
            39.1764, ((0, 1, 2), (2, 0, 1)),
            tilt=(0.00035, 0.00277),
        ),
        Sensor((413, 328), 0.002614, 39.6335),
    ),
    FourDot(2.3228, 7.2889),
    1428.34,
)  # fmt: skip


def seen_from(camera: Camera, target: Target, distance: float) -> Array:
    return (
        np.asarray(render(one_plane(camera, target, distance), tolerance=1e-4)) * 2730
        + NOISE.offset_dn
    )


@pytest.mark.parametrize(
    ("camera", "target", "distance"), [pytest.param(*SIMILAR, marks=pytest.mark.ci), UNLIKE]
)
def test_every_kind_puts_the_dots_where_they_are(
    camera: Camera, target: FourDot, distance: float
) -> None:
    """Read over the rim of the central kind alone, dots at others' rims lay 0.06 px aside, and
    depth 3 of its uncertainty. Where one kind was broadly blurred, the sharp were fitted as
    coarsely as it, and depth was 1.6 off.
    """
    white = seen_from(camera, White(), distance)
    lattice = lattice_behind(camera, white, NOISE)
    dots = count_views(
        seen_from(camera, target, distance), white, lattice, camera, target, distance, NOISE
    )
    for dot in dots:
        off = dot.position_mm - [*target.centres[dot.dot], -distance]
        assert np.all(np.abs(off) < 2 * dot.uncertainty_mm)
