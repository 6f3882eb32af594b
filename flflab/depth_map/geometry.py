"""Where a microlens sees a point, and what its virtual disparity says about its distance.

Letters as in the physics: L main lens to array, b array to sensor, D object distance, D' its image
distance, a = L - D'. The **virtual disparity** is delta = b/a - b/L. The chief ray of an object
point through the main lens's centre crosses the array at t = -o L/D; the microlens at y, whose
micro-image is centred at c = y (1 + b/L), sees the point at

    s = c + delta (y - t) + (kappa + delta) shift(s - c) + inside(s - c),

linear in delta, the same for Keplerian (delta > 0) and Galilean cameras (delta < 0). ``shift`` is
the centroid, on the array, of the microlens's aperture as the main lens's stop cuts it for the
sensor's point, weighted by cos^4 of the ray's slope: what a picture divided by a white one shows is
the target's mean over that cut aperture. ``inside`` is how far the light of a pixel lies inside the
pixel's centre where the light falls towards a micro-image's edge; it counts where micro-images are
a few pixels wide.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flflab.optics.camera import Camera, MainLens
from flflab.optics.per_type import type_smms
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]

TABLE_STEPS = 200  # of the distance from a micro-image's centre
DISTORTION_STEPS = 8
CHORDS = 200  # across the cut aperture
KAPPA_STEPS = tuple(0.02 * step for step in range(-8, 9))  # of itself
SMOOTHING_PX = 0.7  # Gaussian that pictures are smoothed with
_PIXEL, _PIXEL_WEIGHTS = np.polynomial.legendre.leggauss(3)
_BELL, _BELL_WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
_HEIGHTS, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def distance_of(delta: Array, camera: Camera) -> Array:
    """Object distance in mm of a virtual disparity, D = 1/(1/F - 1/(L - a)), a = b/(delta + b/L).

    Infinite or negative where the light would come from infinity or converge before the lens.
    """
    F, L, b = camera.main_lens.focal_length, camera.optical_distance, camera.optical_gap
    with np.errstate(divide="ignore", invalid="ignore"):
        image = L - b / (delta + b / L)
        return 1 / (1 / F - 1 / image)


def disparity_of(distance: Array | float, camera: Camera) -> Array:
    """Inverse of ``distance_of``; at infinity the image lies in the main lens's focus."""
    F, L, b = camera.main_lens.focal_length, camera.optical_distance, camera.optical_gap
    with np.errstate(divide="ignore"):
        image = 1 / (1 / F - 1 / np.asarray(distance, dtype=np.float64))
        return b / (L - image) - b / L


@dataclass(frozen=True)
class Derivatives:
    """How the distance (mm) changes with the disparity and with each length of the camera (mm);
    arrays of the shape of the disparity.
    """

    by_disparity: Array
    by_focal_length: Array
    by_array_distance: Array
    by_gap: Array


def derivatives(delta: Array, camera: Camera) -> Derivatives:
    """Derivatives of ``distance_of`` at a measured disparity, which stays as it is.

    With w = delta + b/L and image D' = L - b/w: dD = D^2/D'^2 (-dD') + D^2/F^2 dF; here
    dD' = dL - db/w + b/w^2 dw and dw = d delta + db/L - b dL/L^2.
    """
    F, L, b = camera.main_lens.focal_length, camera.optical_distance, camera.optical_gap
    D = distance_of(delta, camera)
    w = delta + b / L
    with np.errstate(divide="ignore", invalid="ignore"):
        image = L - b / w
        scale = -((D / image) ** 2)
        by_w = scale * b / w**2
        return Derivatives(
            by_disparity=by_w,
            by_focal_length=(D / F) ** 2,
            by_array_distance=scale - by_w * b / L**2,
            by_gap=-scale / w + by_w / L,
        )


def undistorted(slopes: Array, distance: Array, lens: MainLens) -> Array:
    """Slopes (x, y) of the rays from object points to the main lens's centre, shape (n, 2), from
    those of their images.

    The image of a point at the slope s lies at -s D', displaced by the lens's distortion; the
    inverse is found by fixed-point steps.

    Args:
        slopes: of the images, of the rays through the main lens's centre.
        distance: of the object points, mm, shape (n,).
        lens: the main lens.
    """
    if lens.distortion is None:
        return slopes
    with np.errstate(divide="ignore"):
        image = 1 / (1 / lens.focal_length - 1 / distance)[:, None]
    seen = -slopes * image
    place = seen
    for _ in range(DISTORTION_STEPS):
        place = seen - (lens.distortion.displace(place) - place)
    return -place / image


@dataclass(frozen=True)
class MicrolensKind:
    """One kind of microlens; lengths in pixels of the sensor.

    Attributes:
        kappa: slope of the sensor position over the position on the microlens.
        blur: clear aperture; times |kappa + delta| it is the blur of a point.
        reach: how far from a micro-image's centre pixels are used.
        shift: shift(e)/e at ``TABLE_STEPS`` + 1 even steps of e from 0 to ``table_end``.
        inside: how far the light of a pixel lies inside its centre, over e, at the same steps.
        variance: along one axis, of the cut aperture, px^2, at the same steps.
        table_end: where the tables end.
        skew: what the fall-off of an off-axis microlens adds to the shift, times y.
    """

    kappa: float
    blur: float
    reach: float
    shift: Array
    inside: Array
    variance: Array
    table_end: float
    skew: float


def kinds_of_microlens(
    camera: Camera, least_illumination: float, cut_aperture: bool = True
) -> tuple[MicrolensKind, ...]:
    """Every kind of microlens of a camera, each at ``KAPPA_STEPS`` values of kappa around its own.

    No two microlenses have one focal length to better than about a percent. In focus kappa + delta
    is a small difference, so kappa is taken lens by lens from the white picture's vignetting edge;
    the kinds stand in order of type and, within a type, of kappa.

    Args:
        camera: the camera.
        least_illumination: relative illumination from which on a pixel is used.
        cut_aperture: whether the cut aperture's centroid is taken; without it every view is that
            of a pinhole, which is wrong and here to show by how much.
    """
    pixel = camera.sensor.pixel
    pitch = min(camera.array.pitch) * (1 + camera.optical_gap / camera.optical_distance)
    every = type_smms(camera)
    widest = max(float(one.outside_radius) for one in every)
    kinds: list[MicrolensKind] = []
    for smms in (off_kappa(one, step) for one in every for step in KAPPA_STEPS):
        outside = float(smms.outside_radius)
        rim = min(float(smms.lens_width), float(smms.microlens_width))
        reach = min(outside - least_illumination * rim, pitch - widest)
        table_end = max(outside, pixel)
        places = np.linspace(0, table_end, TABLE_STEPS + 1)
        light, centroid, variance = _cut_aperture(smms, places)
        shift, inside = _as_seen(places / pixel, light, centroid / pixel, SMOOTHING_PX)
        if not cut_aperture:
            shift, inside = np.zeros_like(shift), np.zeros_like(inside)
        limiting = float(smms.limiting_radius)
        skew = limiting**2 / float(smms.distance * smms.gap) if cut_aperture else 0.0
        kinds.append(
            MicrolensKind(
                kappa=float(smms.kappa),
                blur=float(smms.aperture) / pixel,
                reach=reach / pixel,
                shift=shift,
                inside=inside,
                variance=variance / pixel**2,
                table_end=table_end / pixel,
                skew=skew,
            )
        )
    return tuple(kinds)


def by_kappa(disparity: Array, kinds: tuple[MicrolensKind, ...], doubt: float) -> Array:
    """How far disparities are uncertain by a kappa that all microlenses share.

    A view lies at s - c = delta (y - t)/(1 - (kappa + delta) r), r = shift/e: an error of kappa is
    taken for one of delta, d delta = -r delta d kappa / (1 - kappa r).

    Args:
        disparity: of every place.
        kinds: the kinds of microlenses.
        doubt: standard uncertainty of kappa, relative.
    """
    middle = kinds[len(KAPPA_STEPS) // 2 :: len(KAPPA_STEPS)]
    slopes: list[float] = []
    for kind in middle:
        even = np.linspace(0, kind.table_end, len(kind.shift))
        used = (even > 0) & (even <= kind.reach)
        # parallax counts as the square of the distance, and there are as many places as it is far
        ratio = float(np.average(kind.shift[used], weights=even[used] ** 3))
        slopes.append(abs(kind.kappa * ratio / (1 - kind.kappa * ratio)))
    return np.abs(disparity) * doubt * float(np.mean(slopes))


def off_kappa(smms: Smms, relative: float) -> Smms:
    """The system with another focal length, so that kappa is that share larger."""
    focal = smms.gap / (1 + smms.gap / smms.distance - smms.kappa * (1 + relative))
    return replace(smms, focal=focal)


def _cut_aperture(smms: Smms, places: Array) -> tuple[Array, Array, Array]:
    """Light, centroid and variance (along one axis, the mean of both) of the cut aperture at
    distances e from the micro-image's centre.

    The aperture's point q (from the microlens's centre) is lit where |q| <= d/2 and
    |kappa q - e| <= A b/(2 L); its ray has the slope (e - q)/b, its light cos^4 of it.
    """
    kappa, gap = float(smms.kappa), float(smms.gap)
    own = float(smms.aperture) / 2
    shadow = float(smms.lens_width) / 2 / max(abs(kappa), 1e-12)
    nodes = (np.arange(CHORDS) + 0.5) / CHORDS
    light, centroid, variance = (np.zeros_like(places) for _ in range(3))
    for index, place in enumerate(places):
        middle = place / kappa if abs(kappa) > 1e-12 else 0.0
        low, high = max(-own, middle - shadow), min(own, middle + shadow)
        if high - low < 1e-6 * own:  # beyond the total field: what its edge has
            centroid[index], variance[index] = centroid[index - 1], variance[index - 1]
            continue
        q = low + (high - low) * nodes
        chord = np.sqrt(np.maximum(np.minimum(own**2 - q**2, shadow**2 - (q - middle) ** 2), 0.0))
        slope2 = ((place - q)[:, None] ** 2 + (chord[:, None] * _HEIGHTS) ** 2) / gap**2
        part = chord * ((1 + slope2) ** -2 @ _WEIGHTS)
        light[index] = part.sum() * (high - low)
        centroid[index] = float(part @ q / part.sum())
        across = (chord**2) / 3
        variance[index] = float(part @ ((q - centroid[index]) ** 2 + across) / part.sum()) / 2
    return light / light.max(), centroid, variance


def _as_seen(places: Array, light: Array, centroid: Array, smoothing: float) -> tuple[Array, Array]:
    """Means over a pixel, weighted by its light, and over the smoothing of the picture, of which no
    light is weighed: of the centroid, and of how far the light's place lies inside the pixel's
    centre; both over e.

    Args:
        places: e, px, from 0.
        light: at these.
        centroid: at these, px.
        smoothing: standard deviation of the Gaussian, px.
    """

    def mean(points: Array, weights: Array, weigh: Array, radial: Array) -> Array:
        along = places[:, None, None] + points[None, :, None]
        away = np.hypot(along, points[None, None, :])
        share = np.interp(away, places, weigh) * weights[:, None] * weights[None, :]
        toward = np.interp(away, places, radial) * along / np.maximum(away, 1e-9)
        total = share.sum(axis=(1, 2))
        return np.where(total > 0, (share * toward).sum(axis=(1, 2)) / np.maximum(total, 1e-30), 0)

    flat = np.ones_like(places)
    within, spread = 0.5 * _PIXEL, smoothing * _BELL
    lit = np.maximum(light, 1e-6)
    shift = mean(spread, _BELL_WEIGHTS, flat, mean(within, _PIXEL_WEIGHTS, lit, centroid))
    seen = mean(spread, _BELL_WEIGHTS, flat, mean(within, _PIXEL_WEIGHTS, lit, places))
    even = mean(spread, _BELL_WEIGHTS, flat, mean(within, _PIXEL_WEIGHTS, flat, places))
    ratios = np.stack([shift, even - seen])[:, 1:] / places[1:]
    ratios = np.concatenate([ratios[:, :1], ratios], axis=1)
    return ratios[0], ratios[1]
