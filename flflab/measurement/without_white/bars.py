"""The lattice of micro-images from a picture of bars, where there is no white one: in the middle of
a white bar it is as bright as white.

The fit of the bars on the camera's nominal lattice says where on the target each pixel looks; what
blur and pixel bring from black is left out, so that the wide bars alone say where the micro-images
end.
"""

import numpy as np
import numpy.typing as npt

from flflab.errors import MeasurementError
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.profile import cone_of
from flflab.measurement.lattice.registration import sensor_position
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.without_white.plain import lattice_within
from flflab.optics.camera import Camera
from flflab.optics.focus import blur, magnification
from flflab.optics.resolution import central_smms
from flflab.targets import Bars

Array = npt.NDArray[np.float64]

EDGE_PX = 1.5  # of a bar that is not looked at, beside its blur
ROUNDS = 2  # which pixels belong to one micro-image alone is known as well as the lattice is
WORST_PX = 0.5  # of the origin


def lattice_from_bars(
    picture: npt.NDArray[np.generic],
    nominal: Lattice,
    camera: Camera,
    target: Bars,
    distance: float,
    noise: SensorNoise,
) -> Lattice:
    """Measure the lattice in a picture of square bars.

    Args:
        picture: DN, [row, col].
        nominal: the camera's lattice, right to a few pixels; its light need not be.
        camera: nominal, of one kind of microlenses.
        target: what stood there.
        distance: main lens to target, mm, nominal.
        noise: of the sensor.

    Raises:
        MeasurementError: the bars cannot be fitted, or too few pixels look into white ones.
    """
    values = np.ascontiguousarray(picture, dtype=np.float32)
    found = nominal
    for _ in range(ROUNDS):
        geometry = fit_contrast(picture, found, camera, target, distance, noise).geometry
        plain = _plain(values, found, camera, target, distance, geometry, noise)
        white = plain[plain < noise.full_scale_dn]
        if white.size > 0:
            found = lattice_within(
                plain,
                nominal,
                float(np.quantile(white, 0.9)) - noise.offset_dn,
                noise,
                cone_of(camera),
            )
        if white.size == 0 or not np.max(found.origin_uncertainty_px) < WORST_PX:
            raise MeasurementError(
                f"{target.kind} picture: the {white.size} pixels in the middle of white bars do not"
                " show where the micro-images are; take a white picture, or bars of lower"
                " frequency"
            )
    return found


def _plain(
    values: npt.NDArray[np.float32],
    nominal: Lattice,
    camera: Camera,
    target: Bars,
    distance: float,
    geometry: Array,
    noise: SensorNoise,
) -> npt.NDArray[np.float32]:
    """The picture where it looks into white bars; all else saturated, which the fit leaves out."""
    smms, pixel = central_smms(camera), camera.sensor.pixel
    off = (float(blur(smms, 1 / distance)) / 2 + EDGE_PX * pixel) / float(
        magnification(smms, 1 / distance)
    )
    reach = nominal.outside_radius_px + 2
    lit, white = np.zeros(values.shape, dtype=np.int8), np.zeros(values.shape, dtype=np.int8)
    for x, y in nominal.centres_px:
        top, left = max(0, int(y - reach)), max(0, int(x - reach))
        window = np.s_[top : int(y + reach) + 1, left : int(x + reach) + 1]
        rows, columns = np.indices(values[window].shape)
        right, down = columns + left - x, rows + top - y
        centre = sensor_position(camera.sensor, np.array([[x, y]]))[0]
        across = (
            geometry[0] + centre @ geometry[3:] + pixel * (geometry[1] * right + geometry[2] * down)
        )
        up = (
            centre[1] * geometry[3] + pixel * geometry[1] * down
        )  # the bars say nothing of where they end above and below
        sure = (np.abs(across) < target.width / 2 - off) & (
            np.abs(up) < 0.9 * target.height / 2 - off
        )
        phase = target.phase(np.clip(across, -target.width / 2, target.width / 2))
        rise, fall = target.position(np.floor(phase)), target.position(np.floor(phase) + 0.5)
        own = np.hypot(right, down) < reach
        lit[window] += own
        white[window] += own & sure & (across > rise + off) & (across < fall - off)
    # where micro-images overlap each of them must look into white
    return np.where((lit > 0) & (white == lit), values, noise.saturated_dn)
