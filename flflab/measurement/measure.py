"""One frame measured: what ``flflab measure --json`` says, from a picture, the camera and what the
target was.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.errors import InputError, MeasurementError
from flflab.measurement.as_read import as_read
from flflab.measurement.contrast.curve import fit_contrasts
from flflab.measurement.dots.scale import scale_of_dots, unlike_the_description
from flflab.measurement.dots.views import count_views
from flflab.measurement.edges.views import EdgeCurve, measure_edges
from flflab.measurement.lattice.kinds import kinds_of
from flflab.measurement.lattice.profile import cone_of
from flflab.measurement.lattice.registration import microlens_type_of, sensor_pixel
from flflab.measurement.lattice.white import Lattice, find_lattice, pitch_and_angle
from flflab.measurement.measure_json import (
    contrast_json,
    dot_json,
    edge_json,
    lattice_json,
    micro_images_json,
)
from flflab.measurement.micro_images import every_micro_image
from flflab.measurement.presence import (
    brightest_light,
    require_blur_within,
    require_dots,
    require_light,
)
from flflab.measurement.sensor.noise import SensorNoise
from flflab.measurement.without_white.bars import lattice_from_bars
from flflab.measurement.without_white.dots import lattice_from_dots
from flflab.optics.camera import Camera, microlens_centres
from flflab.optics.focus import sharp_vergence
from flflab.optics.per_type import type_smms
from flflab.optics.resolution import central_smms
from flflab.raw_file import RawPicture
from flflab.sensor_picture import SensorPicture
from flflab.targets import Bars, Chirp, Edge, FourDot, Target, White

Array = npt.NDArray[np.float64]

RADIUS_TOLERANCE = 0.05  # a measured radius that differs more from the camera's is remarked on
PITCH_TOLERANCE = 0.01  # the same of the pitch
NOMINAL_UNCERTAINTY_PX = 1.0


def measure(
    picture: npt.NDArray[np.generic] | RawPicture | SensorPicture,
    camera: Camera,
    target: Target | None = None,
    distance: float | None = None,
    noise: SensorNoise | None = None,
    white: npt.NDArray[np.generic] | RawPicture | SensorPicture | None = None,
) -> dict[str, Any]:
    """Measure one frame.

    A white frame gives the lattice, of which only layout and rough pitch are taken from the camera.
    Another frame is measured on the lattice of the white one beside it. Without one the lattice is
    measured where dots or bars are white, from the camera's nominal one; sines and edges are
    measured on that itself. A remark says so.

    Args:
        picture: [row, col]; DN, or any other unit where ``noise`` is None. A raw one is measured
            above its black level, the filters of its mosaic as four sub-lattices.
        camera: nominal.
        target: what stood there; None means white.
        distance: main lens to target, mm; None means where the camera is sharp.
        noise: of the sensor; None estimates it from the picture.
        white: a picture of a white target, taken as this one was; None: there is none.

    Returns:
        ``lattice``, ``dots``, ``mtf`` as in the contract of ``measure --json`` (pixels, (x, y); mm;
        None where there is no value), with the lattice's standard uncertainties, and ``remarks``,
        sentences.

    Raises:
        InputError: a target this cannot measure, or no distance where one is needed.
        MeasurementError: the picture does not hold what was to be measured.
    """
    target = White() if target is None else target
    if not isinstance(target, White | FourDot | Bars | Edge):
        kinds = ", ".join(kind.kind for kind in (White, FourDot, Bars, Chirp, Edge))
        raise InputError(f"measure: a {target.kind} target cannot be measured; allowed are {kinds}")
    if white is not None and isinstance(target, White):
        raise InputError(
            "measure: a white picture beside a white one; it belongs beside a picture of another"
            " target"
        )
    mosaic, read = as_read(picture, camera, target.kind, noise)
    remarks = [remark.sentence for remark in read]
    values, evened = mosaic.even()
    require_light(values, evened, target)
    result: dict[str, Any] = {"dots": [], "mtf": []}
    if isinstance(target, White):
        lattice = _lattice_of_white(values, evened, camera, remarks)
        each = micro_images_json(
            every_micro_image(values, lattice, evened), nominal_radii(lattice, camera)
        )
        return {
            "lattice": lattice_json(lattice) | {"micro_images": each},
            **result,
            "remarks": remarks,
        }
    away = _sharp_distance(camera) if distance is None else distance
    if white is None:
        lattice = _lattice_without_white(values, evened, camera, target, away, remarks)
    else:
        beside, notes = as_read(white, camera, White.kind, noise)
        remarks += [f"white picture: {note.sentence}" for note in notes]
        require_light(*beside.even(), White())
        lattice = _lattice_of_white(*beside.even(), camera, remarks)
    if isinstance(target, FourDot):
        dots = count_views(values, None, lattice, camera, target, away, evened)
        require_dots(values, dots, camera, target, away, evened)
        result["dots"] = [dot_json(dot) for dot in dots]
        scale = scale_of_dots(dots, lattice, camera, target, away)
        remarks += unlike_the_description(scale, camera, away) if scale else []
    elif isinstance(target, Edge):
        edges = measure_edges(values, lattice, camera, evened)
        result["mtf"] = edge_json(edges, camera, away)
        remarks += _edge_remarks(edges)
    else:
        curves, reasons = fit_contrasts(
            mosaic.values, lattice, camera, target, away, mosaic.noise, mosaic.gains
        )
        result["mtf"] = [point for curve in curves for point in contrast_json(curve, lattice)]
        remarks += reasons
    return {"lattice": lattice_json(lattice), **result, "remarks": remarks}


def _lattice_of_white(
    values: npt.NDArray[np.floating[Any]], noise: SensorNoise, camera: Camera, remarks: list[str]
) -> Lattice:
    """The lattice of a white picture; remarks say what is unlike the camera."""
    kinds = kinds_of(camera)
    # micro-images of kinds that are taken for one have no one profile in which their fall-off could
    # be told
    cone = cone_of(camera) if kinds or len(camera.array.focal_lengths) == 1 else None
    lattice = find_lattice(
        values, camera.array.layout, nominal_lattice(camera, 1.0).pitch_px, noise, cone, kinds
    )
    remarks += _unlike_the_camera(lattice, camera)
    if cone is None:
        remarks.append(
            "microlenses of several kinds: natural fall-off is left out, where there is any radii"
            " are off by up to a pixel, far more than their uncertainty"
        )
    return lattice


def _lattice_without_white(
    values: npt.NDArray[np.floating[Any]],
    noise: SensorNoise,
    camera: Camera,
    target: FourDot | Bars | Edge,
    distance: float,
    remarks: list[str],
) -> Lattice:
    """The lattice measured within dots or white bars, from the camera's nominal one, else that one;
    a remark says which and why.
    """
    nominal, why = nominal_lattice(camera, brightest_light(values, noise)), ""
    try:
        if isinstance(target, FourDot):
            found, where = (
                lattice_from_dots(values, nominal, camera, target, distance, noise),
                "the dots",
            )
        elif (
            isinstance(target, Bars)
            and target.kind == "bars"
            and len(camera.array.focal_lengths) == 1
        ):
            found, where = (
                lattice_from_bars(values, nominal, camera, target, distance, noise),
                "the white bars",
            )
        else:
            found, where = nominal, ""
    except MeasurementError as error:
        if isinstance(target, FourDot):
            require_blur_within(nominal, camera, distance)
        found, where, why = nominal, "", f" ({error})"
    measured = (
        f"was measured within {where}, from the camera's nominal one"
        if where
        else "is the camera's nominal one, not measured"
    )
    remarks.append(f"no white picture: the lattice {measured}{why}")
    return found


def nominal_lattice(camera: Camera, light_dn: float) -> Lattice:
    """The lattice that the camera's description says; radii and centres good to a pixel, light the
    same everywhere.
    """
    smms = central_smms(camera)
    width, height = camera.sensor.resolution
    centres = sensor_pixel(camera.sensor, microlens_centres(camera.array) * float(smms.image_scale))
    pitch = np.asarray(camera.array.pitch) * float(smms.image_scale) / camera.sensor.pixel
    slant = (
        np.array([[1.0, 0.5], [0.0, math.sqrt(3) / 2]])
        if camera.array.layout == "hexagonal"
        else np.eye(2)
    )
    cos, sin = math.cos(camera.array.roll), math.sin(camera.array.roll)
    vectors = np.array([[cos, -sin], [sin, cos]]) @ (pitch[:, None] * slant)
    outside = float(smms.outside_radius) / camera.sensor.pixel
    off = np.hypot(*(centres - np.clip(centres, -0.5, [width - 0.5, height - 0.5])).T)
    centres = centres[off < outside]
    if len(centres) == 0:
        raise InputError(
            "camera: no micro-image falls on the sensor; check the offsets of array and sensor"
        )
    origin = centres[int(np.argmin(np.hypot(*(centres - [(width - 1) / 2, (height - 1) / 2]).T)))]
    length, angle = pitch_and_angle(camera.array.layout, vectors)
    return Lattice(
        layout=camera.array.layout,
        pitch_px=length,
        angle=angle,
        origin_px=origin,
        vectors_px=vectors,
        indices=np.rint((centres - origin) @ np.linalg.inv(vectors).T).astype(np.int64),
        centres_px=centres,
        inside_radius_px=float(smms.inside_radius) / camera.sensor.pixel,
        outside_radius_px=outside,
        pitch_uncertainty_px=math.nan,
        angle_uncertainty=math.nan,
        origin_uncertainty_px=np.full(2, NOMINAL_UNCERTAINTY_PX),
        inside_uncertainty_px=NOMINAL_UNCERTAINTY_PX,
        outside_uncertainty_px=NOMINAL_UNCERTAINTY_PX,
        covariance_px=np.full((6, 6), math.nan),
        sizes_covariance_px=np.full((3, 3), math.nan),
        chi2_per_pixel=math.nan,
        background_dn=0.0,
        light=np.array([light_dn, 0, 0, 0, 0, 0.0]),
        cone=cone_of(camera) if any(camera.array.tilt) else None,
        slants=np.zeros(4),
        tilt=np.array(camera.array.tilt),
        kinds=kinds_of(camera),
    )


def nominal_radii(lattice: Lattice, camera: Camera) -> Array:
    """Radii of bright and total field of each of the lattice's micro-images by the camera's
    description, px, shape (n, 2).
    """
    focal = microlens_type_of(lattice, camera)
    radii = np.full((len(focal), 2), math.nan)
    for smms in type_smms(camera):
        radii[focal == float(smms.focal)] = float(smms.inside_radius), float(smms.outside_radius)
    return radii / camera.sensor.pixel


def _sharp_distance(camera: Camera) -> float:
    vergence = float(sharp_vergence(central_smms(camera)))
    if not (math.isfinite(vergence) and vergence > 0):
        raise InputError(
            "measure: this camera is sharp at no real distance; give the target's distance"
        )
    return 1 / vergence


def _unlike_the_camera(lattice: Lattice, camera: Camera) -> list[str]:
    nominal, remarks = nominal_lattice(camera, 1.0), list[str]()
    if abs(lattice.pitch_px / nominal.pitch_px - 1) > PITCH_TOLERANCE:
        remarks.append(
            f"the pitch is {lattice.pitch_px:.2f} px, the camera's description makes it"
            f" {nominal.pitch_px:.2f} px; check pitch, pixel and distances"
        )
    pairs = [
        (
            "inside",
            lattice.inside_radius_px,
            nominal.inside_radius_px,
            lattice.inside_uncertainty_px,
        ),
        (
            "outside",
            lattice.outside_radius_px,
            nominal.outside_radius_px,
            lattice.outside_uncertainty_px,
        ),
    ]
    return remarks + [
        f"the {name} radius is {found:.2f} px, the camera's description makes it {due:.2f} px;"
        " check f-number, apertures and distances"
        for name, found, due, doubt in pairs
        if abs(found - due) > max(RADIUS_TOLERANCE * due, 4 * doubt, 0.5)
    ]


def _edge_remarks(curve: EdgeCurve) -> list[str]:
    views = f"the transfer function is that of {len(curve.views)} edges, along their normal"
    if not curve.starved:
        return [views]
    slope = math.degrees(curve.views[0].fit.angle)
    return [
        views,
        (
            f"{curve.starved} of the edges, at {slope:.2f} deg, sample their profile at too few"
            " places in a pixel; turn the target by a degree"
        ),
    ]
