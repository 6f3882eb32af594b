"""One frame measured: what ``flflab measure --json`` says, from a picture, the camera and what the target was."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from flflab.analysis.contrast import ContrastCurve, fit_contrast
from flflab.analysis.dots import DotViews, count_views
from flflab.analysis.edges import EdgeCurve, measure_edges
from flflab.analysis.lattice import Lattice, find_lattice, pitch_and_angle
from flflab.analysis.noise import SensorNoise, estimate_noise
from flflab.analysis.registration import require_picture, sensor_pixel
from flflab.errors import InputError
from flflab.optics.camera import Camera, microlens_centres
from flflab.optics.focus import magnification, sharp_vergence
from flflab.optics.resolution import central_smms
from flflab.targets import Bars, Chirp, Edge, FourDot, Target, White

Array = npt.NDArray[np.float64]

RADIUS_TOLERANCE = 0.05  # a measured radius that differs more from the camera's is remarked on
NOMINAL_UNCERTAINTY_PX = 1.0
SCALED_WHITE_DN = 4000.0


def measure(
    picture: npt.NDArray[np.generic],
    camera: Camera,
    target: Target | None = None,
    distance: float | None = None,
    noise: SensorNoise | None = None,
) -> dict[str, Any]:
    """Measure one frame.

    A white frame gives the lattice, of which only layout and rough pitch are taken from the camera. A frame of dots, bars or edges is
    measured on the camera's nominal lattice, and a remark says so.

    Args:
        picture: [row, col]; DN, or any other unit where ``noise`` is None.
        camera: nominal.
        target: what stood there; None means white.
        distance: main lens to target, mm; None means where the camera is sharp.
        noise: of the sensor; None estimates it from the picture.

    Returns:
        ``lattice``, ``dots``, ``mtf`` as in the contract of ``measure --json`` (pixels, (x, y); mm; None where there is no value),
        with the lattice's standard uncertainties, and ``remarks``, sentences.

    Raises:
        InputError: a target this cannot measure, or no distance where one is needed.
        MeasurementError: the picture does not hold what was to be measured.
    """
    target = White() if target is None else target
    values, remarks = require_picture(picture, camera, target.kind), list[str]()
    if noise is None:
        floating = np.asarray(picture).dtype.kind == "f"
        if floating:
            # in units of the white level the rounding of whole numbers would count as noise
            values = values * (SCALED_WHITE_DN / max(float(np.quantile(values, 0.999)), 1e-300))
        noise = estimate_noise(values if floating else picture)
        remarks.append("the sensor's noise was estimated from the picture itself")
    result: dict[str, Any] = {"dots": [], "mtf": []}
    if isinstance(target, White):
        lattice = find_lattice(values, camera.array.layout, nominal_lattice(camera, 1.0).pitch_px, noise)
        remarks += _radius_remarks(lattice, camera)
    elif isinstance(target, FourDot | Bars | Edge):
        lattice = nominal_lattice(camera, max(float(np.quantile(values, 0.999)) - noise.offset_dn, 1.0))
        remarks.append("no white picture: the lattice is the camera's nominal one, not measured")
        away = _sharp_distance(camera) if distance is None else distance
        if isinstance(target, FourDot):
            result["dots"] = [_dot(dot) for dot in count_views(values, None, lattice, camera, target, away, noise)]
        elif isinstance(target, Edge):
            edges = measure_edges(values, lattice, camera, noise)
            result["mtf"] = _edge_curve(edges, camera, away)
            remarks += _edge_remarks(edges)
        else:
            result["mtf"] = _curve(fit_contrast(values, lattice, camera, target, away, noise))
    else:
        kinds = ", ".join(kind.kind for kind in (White, FourDot, Bars, Chirp, Edge))
        raise InputError(f"measure: a {target.kind} target cannot be measured; allowed are {kinds}")
    return {"lattice": _lattice(lattice), **result, "remarks": remarks}


def nominal_lattice(camera: Camera, light_dn: float) -> Lattice:
    """The lattice that the camera's description says; radii and centres good to a pixel, light the same everywhere."""
    smms = central_smms(camera)
    width, height = camera.sensor.resolution
    centres = sensor_pixel(camera.sensor, microlens_centres(camera.array) * float(smms.image_scale))
    pitch = np.asarray(camera.array.pitch) * float(smms.image_scale) / camera.sensor.pixel
    slant = np.array([[1.0, 0.5], [0.0, math.sqrt(3) / 2]]) if camera.array.layout == "hexagonal" else np.eye(2)
    cos, sin = math.cos(camera.array.roll), math.sin(camera.array.roll)
    vectors = np.array([[cos, -sin], [sin, cos]]) @ (pitch[:, None] * slant)
    outside = float(smms.outside_radius) / camera.sensor.pixel
    off = np.hypot(*(centres - np.clip(centres, -0.5, [width - 0.5, height - 0.5])).T)
    centres = centres[off < outside]
    if len(centres) == 0:
        raise InputError("camera: no micro-image falls on the sensor; check the offsets of array and sensor")
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
        chi2_per_pixel=math.nan,
        background_dn=0.0,
        light=np.array([light_dn, 0, 0, 0, 0, 0.0]),
    )


def _sharp_distance(camera: Camera) -> float:
    vergence = float(sharp_vergence(central_smms(camera)))
    if not (math.isfinite(vergence) and vergence > 0):
        raise InputError("measure: this camera is sharp at no real distance; give the target's distance")
    return 1 / vergence


def _radius_remarks(lattice: Lattice, camera: Camera) -> list[str]:
    nominal = nominal_lattice(camera, 1.0)
    pairs = [
        ("inside", lattice.inside_radius_px, nominal.inside_radius_px, lattice.inside_uncertainty_px),
        ("outside", lattice.outside_radius_px, nominal.outside_radius_px, lattice.outside_uncertainty_px),
    ]
    return [
        f"the {name} radius is {found:.2f} px, the camera's description makes it {due:.2f} px; check f-number, apertures and distances"
        for name, found, due, doubt in pairs
        if abs(found - due) > max(RADIUS_TOLERANCE * due, 4 * doubt, 0.5)
    ]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _lattice(lattice: Lattice) -> dict[str, Any]:
    return {
        "layout": lattice.layout,
        "pitch_px": lattice.pitch_px,
        "angle_deg": math.degrees(lattice.angle),
        "origin_px": lattice.origin_px.tolist(),
        "centres_px": lattice.centres_px.tolist(),
        "inside_radius_px": lattice.inside_radius_px,
        "outside_radius_px": lattice.outside_radius_px,
        "uncertainty": {
            "pitch_px": _number(lattice.pitch_uncertainty_px),
            "angle_deg": _number(math.degrees(lattice.angle_uncertainty)),
            "origin_px": [_number(value) for value in lattice.origin_uncertainty_px],
            "inside_radius_px": _number(lattice.inside_uncertainty_px),
            "outside_radius_px": _number(lattice.outside_uncertainty_px),
        },
    }


def _dot(dot: DotViews) -> dict[str, Any]:
    return {
        "dot": dot.dot,
        "views": dot.views,
        "views_uncertain": dot.views_uncertain,
        "centres_px": dot.centres_px.tolist(),
        "position_mm": [_number(value) for value in dot.position_mm],
        "uncertainty_mm": [_number(value) for value in dot.uncertainty_mm],
    }


def _curve(curve: ContrastCurve) -> list[dict[str, float]]:
    return [
        {"cycles_per_px": float(u), "cycles_per_mm": float(nu), "contrast": float(contrast), "uncertainty": float(doubt)}
        for u, nu, contrast, doubt in zip(curve.cycles_per_px, curve.cycles_per_mm, curve.contrast, curve.uncertainty, strict=True)
    ]


def _edge_curve(curve: EdgeCurve, camera: Camera, distance: float) -> list[dict[str, float]]:
    scale = float(magnification(central_smms(camera), 1 / distance)) / camera.sensor.pixel
    return [
        {"cycles_per_px": float(u), "cycles_per_mm": float(u) * scale, "contrast": float(mtf), "uncertainty": float(doubt)}
        for u, mtf, doubt in zip(curve.cycles_per_px, curve.mtf, curve.uncertainty, strict=True)
    ]


def _edge_remarks(curve: EdgeCurve) -> list[str]:
    views = f"the transfer function is that of {len(curve.views)} edges, along their normal"
    if not curve.starved:
        return [views]
    slope = math.degrees(curve.views[0].fit.angle)
    return [
        views,
        f"{curve.starved} of the edges, at {slope:.2f} deg, sample their profile at too few places in a pixel; turn the target by a degree",
    ]
