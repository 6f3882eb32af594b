"""From a scene to its regime: what its lenses say about blur, rims, overlap and steepness, without
forming a picture.
"""

import math
from dataclasses import astuple, replace

import numpy as np
import numpy.typing as npt

from flflab.image.microlenses import Lenses, camera_lenses, is_lit, outside
from flflab.image.regime import Change, PlaneRegime, Regime
from flflab.image.scene import ALL, Plane, Scene, without
from flflab.optics.discs import two_disc_area
from flflab.targets import Bars, Black, Edge, Picture, White

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def survey(scene: Scene) -> Regime:
    """The regime of a scene.

    Raises:
        InputError: a tilted array reaches through the sensor.
    """
    camera, pixel = scene.camera, scene.camera.sensor.pixel
    lenses = camera_lenses(camera, 1 / scene.planes[0].distance, scene.scatter)
    seen = is_lit(lenses)
    radius, slope = outside(lenses)[seen], np.abs(lenses["slope"][seen])
    level = float(lenses["level"][seen].max(initial=0.0))
    gap, crosstalk, reaching = _neighbours(lenses, seen, pixel)
    light = level + crosstalk
    width = 2 * slope / pixel
    cones = np.abs(lenses["slant_spread"][seen])
    narrowest = max(float(width.min(initial=math.inf)), 1e-9)
    planes = tuple(_plane(scene, plane, seen, light, reaching * level) for plane in scene.planes)
    columns, rows = camera.sensor.resolution
    return Regime(
        planes=planes,
        pixel=pixel,
        pixels=columns * rows,
        lit=min(1.0, math.pi * float((radius**2).sum()) / (columns * rows * pixel**2)),
        microlenses=int(seen.sum()),
        light=light,
        brightest=light * max(_brightest(plane) for plane in scene.planes),
        reaching=reaching,
        rim=float(width.max(initial=0.0)),
        least_rim=float(width.min(initial=math.inf)) if len(width) else 0.0,
        rim_steepness=reaching * level * min(math.sqrt(2), 4 / (math.pi * narrowest)),
        gap=gap,
        crosstalk=crosstalk,
        airy=0.61 / max(float(cones.min(initial=math.inf)), 1e-300) / pixel,
        slope=_steepest_ray(lenses, seen),
        misaligned=_without(scene, "misalignment", seen),
        scattered=_without(scene, "scatter", seen),
    )


def _neighbours(lenses: Lenses, seen: Flags, pixel: float) -> tuple[float, float, int]:
    """Gap between neighbouring micro-images in pixels, most light that a pixel has from neighbours,
    most micro-images on a pixel.

    A pixel belongs to the micro-image whose centre is nearest, so no neighbour's centre is nearer
    than half the way between the two.
    """
    places = np.stack([lenses["x"], lenses["y"]], axis=1)
    owners = np.flatnonzero(seen)
    if len(places) < 2 or not len(owners):
        return math.inf, 0.0, 1
    middle = places[owners].mean(axis=0)
    by_distance = np.argsort(np.hypot(*(places[owners] - middle).T))
    owners = owners[by_distance[:9]]  # unlike microlenses repeat within a few
    gap, crosstalk, reaching = math.inf, 0.0, 1
    for owner in owners:
        apart = np.hypot(*(places - places[owner]).T)
        others = (apart > 0) & (apart / 2 - pixel < outside(lenses))
        between = (apart - outside(lenses)[owner] - outside(lenses))[apart > 0]
        gap = min(gap, float(between.min()) / pixel)
        nearest = np.maximum(apart[others] / 2 - pixel / math.sqrt(2), 0)
        slope = np.maximum(np.abs(lenses["slope"][others]), 1e-9)
        shares = [
            two_disc_area(1.0, *pair) / math.pi
            for pair in zip(lenses["reach"][others] / slope, nearest / slope, strict=True)
        ]
        crosstalk = max(crosstalk, float(np.dot(shares, lenses["level"][others])))
        reaching = max(reaching, 1 + int(others.sum()))
    return gap, crosstalk, reaching


def _plane(scene: Scene, plane: Plane, seen: Flags, light: float, reaching: float) -> PlaneRegime:
    """The regime of one target; ``reaching`` counts micro-images on a pixel, each with its
    level.
    """
    camera, pixel = scene.camera, scene.camera.sensor.pixel
    lenses = camera_lenses(camera, 1 / plane.distance, scene.scatter)
    spread, scale = np.abs(lenses["spread"][seen]), np.abs(lenses["scale"][seen]) * pixel
    away = np.minimum(outside(lenses)[seen] / pixel, math.hypot(*camera.sensor.resolution) + 1)
    field = float(
        (np.hypot(lenses["direction_x"], lenses["direction_y"])[seen] + scale * away + spread).max(
            initial=0.0
        )
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        blur = np.where(spread == 0, 0.0, 2 * spread / scale)
        by_pixel, by_blur = light * math.sqrt(2) / scale, reaching * 2 / (math.pi * spread)
    steepness = np.fmin(by_pixel, by_blur).max(initial=0.0)
    finite = math.isfinite(plane.distance)
    from_centre = field + (math.hypot(*plane.offset) / plane.distance if finite else 0.0)
    if len(scene.planes) > 1:
        steepness = 3 * steepness  # a card that moves uncovers what is behind it, on two sides
    return PlaneRegime(
        distance=plane.distance,
        blur=float(blur.max(initial=0.0)),
        least_blur=float(blur.min(initial=math.inf)) if len(blur) else 0.0,
        field=field,
        from_centre=from_centre,
        bundle=float((spread + scale).max(initial=0.0)),
        pixel_angle=float(scale.min(initial=math.inf)) if len(scale) else 0.0,
        contrast=light * _contrast(plane, len(scene.planes)),
        steepness=float(steepness),
        plain=isinstance(plane.target, Bars | Edge) and plane.size is None,
    )


def _contrast(plane: Plane, planes: int) -> float:
    """Range of the radiance on a target, its surroundings included."""
    if isinstance(plane.target, White | Black) and plane.size is None and planes == 1:
        return 0.0
    return _brightest(plane) if planes == 1 else 1.0


def _brightest(plane: Plane) -> float:
    """Highest radiance on a target."""
    if isinstance(plane.target, Picture):
        return float(plane.target.values.max())
    return 0.0 if isinstance(plane.target, Black) else 1.0


def _steepest_ray(lenses: Lenses, seen: Flags) -> float:
    """Largest slope of a ray that reaches the sensor."""
    slant = (
        np.hypot(lenses["slant_x"], lenses["slant_y"])
        + np.abs(lenses["slant_scale"]) * outside(lenses)
        + np.abs(lenses["slant_spread"])
    )
    return float(slant[seen].max(initial=0.0))


def _changed(old: Lenses, new: Lenses, seen: Flags, pixel: float) -> Change:
    """What becomes of the rays and rims of the micro-images seen when these are the lenses
    instead.
    """
    if np.any((old["lens_scale"] == 0) != (new["lens_scale"] == 0)):  # another aperture limits
        return Change(math.inf, math.inf, 0.0, 1.0)
    step = np.hypot(new["x"] - old["x"], new["y"] - old["y"])
    turned = np.hypot(
        new["direction_x"] - old["direction_x"], new["direction_y"] - old["direction_y"]
    )
    apart = np.abs(new["spread"] - old["spread"]) + np.abs(new["scale"] - old["scale"]) * outside(
        old
    )
    rims = step + np.abs(new["slope"] - old["slope"]) + np.abs(new["reach"] - old["reach"])
    return Change(
        rim=float(rims[seen].max(initial=0.0)) / pixel,
        shift=float((turned + np.abs(new["scale"]) * step)[seen].max(initial=0.0)),
        stretch=float(apart[seen].max(initial=0.0)),
        level=float(np.abs(new["level"] / old["level"] - 1)[seen].max(initial=0.0)),
    )


def _without(scene: Scene, name: str, seen: Flags) -> Change:
    """What becomes of rays and rims without the misalignment or the scatter."""
    camera, ideal = scene.camera, without(scene, ALL - {name})
    if (camera, scene.scatter) == (ideal.camera, ideal.scatter):
        return Change()
    step = math.dist(camera.sensor.offset, ideal.camera.sensor.offset)
    changes: list[Change] = []
    for plane in scene.planes:
        old = camera_lenses(camera, 1 / plane.distance, scene.scatter)
        new = camera_lenses(ideal.camera, 1 / plane.distance, ideal.scatter)
        moved = seen | is_lit(new)
        change = _changed(old, new, moved, camera.sensor.pixel)
        turned = step * float(np.abs(old["scale"]).max())  # the sensor's own offset moves all alike
        rim = change.rim + step / camera.sensor.pixel
        changes.append(replace(change, rim=rim, shift=change.shift + turned))
    return Change(*np.max([astuple(one) for one in changes], axis=0).tolist())
