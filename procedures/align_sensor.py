"""Move the sensor by white pictures: into the exit pupil, where nothing is vignetted, or until
neighbouring micro-images overlap as wanted.

The radius of the microlens's shadow, which is 0 in the exit pupil, is hardly seen where it is
small, and its sign never. So the pupil is found from pictures to both sides of it and then gone to.
"""

from collections.abc import Generator
from typing import Any

import numpy as np
from bluesky import Msg

from flflab.alignment import (
    Crossing,
    Outcome,
    find_crossing,
    measured_overlap,
    microlens_shadow,
    nominal_slopes,
)
from flflab.digits import plus_minus
from flflab.errors import InputError
from flflab.optics.camera import Camera
from flflab.optics.resolution import central_smms
from procedures.white_pictures import Looking, Seen, approach

Plan = Generator[Msg, Any, Any]

MOST_PICTURES = 6
PROBE_PX = 1.0  # radius of the microlens's shadow in the pictures to both sides of the exit pupil


def place_sensor(looking: Looking, first: Seen, overlap: float | None) -> Plan:
    """Move the sensor to an overlap in mm, or into the exit pupil where that is None; returns the
    ``Outcome``.

    Args:
        looking: the bench.
        first: picture taken where the sensor stands now.
        overlap: wanted, negative for a gap.
    """
    bench = looking.bench
    axis, found = bench.axis_of("sensor.z"), bench.described.description.axis_of("sensor.z")
    if axis is None or found is None:
        raise InputError(
            f"align: no axis of {bench.described.file} moves the sensor; give one, or leave the"
            " sensor where it stands"
        )
    what, measure = (
        ("exit pupil", microlens_shadow) if overlap is None else ("overlap", measured_overlap)
    )
    slope = nominal_slopes(first.camera)[overlap is not None]
    probe = PROBE_PX * first.camera.sensor.pixel / abs(slope)
    places, values, doubts = (
        [found[1].world(axis.position())],
        *([part] for part in measure(first.lattice, first.camera)),
    )

    def crossing() -> Crossing:
        used = (
            slice(None) if overlap is not None else slice(0, 3)
        )  # in the pupil itself the shadow is too small to tell
        z, value, u = (np.array(part[used]) for part in (places, values, doubts))
        return find_crossing(z, value, u, slope, overlap or 0.0, signed=overlap is not None)

    there, doubt, why = crossing(), 0.0, ""
    while not why:
        aside = {1: probe, 2: -probe}.get(len(places), 0.0) if overlap is None else 0.0
        yield from approach(bench.described, axis, found[1].reading(there.place + aside))
        seen = yield from looking.look()
        value, u = measure(seen.lattice, seen.camera)
        places.append(found[1].world(axis.position()))
        values.append(value)
        doubts.append(u)
        looking.tell(
            f"picture {looking.pictures}: sensor at {places[-1]:.4f} mm, {what}:"
            f" ({plus_minus(1e3 * value, 1e3 * u)}) um"
        )
        there = crossing()
        doubt = float(np.hypot(there.uncertainty, axis.resolution / 12**0.5))
        if overlap is None and len(places) < 4:
            continue
        if abs(places[-1] - there.place) <= 2 * doubt:
            why = "within twice the measurement's uncertainty"
        elif abs(places[-1] - there.place) <= 1.01 * axis.resolution:
            why = "the stage makes no smaller step"
        elif len(places) >= MOST_PICTURES:
            why = f"{MOST_PICTURES} pictures were taken"
    return Outcome(
        what,
        axis.name,
        places[0] - there.place,
        places[-1] - there.place,
        doubt,
        axis.position(),
        len(places),
        why,
    )


def expected_sensor(camera: Camera, overlap: float | None) -> float:
    """Where the sensor would have to stand by the camera's description, mm from the main lens.

    kappa = 0 at b = 1 / (1/f - 1/L); A b/L + d |kappa| - p (1 + b/L) = overlap on the side of it on
    which the camera is.

    Raises:
        InputError: there is no such place behind the array.
    """
    smms = central_smms(camera)
    L, f, A, d = (
        float(smms.distance),
        float(smms.focal),
        float(smms.lens_aperture),
        float(smms.aperture),
    )
    gap = 1 / (1 / f - 1 / L)
    if overlap is not None:
        sign, pitch = -1.0 if float(smms.gap) > gap else 1.0, min(camera.array.pitch)
        gap = (overlap + pitch - sign * d) / ((A - pitch) / L + sign * d * (1 / L - 1 / f))
    if not gap > 0:
        asked = "exit pupil" if overlap is None else f"overlap of {overlap:g} mm"
        raise InputError(
            f"align: behind the array there is no {asked} at f/{camera.main_lens.f_number:g};"
            " change one of the two"
        )
    return camera.array.distance + gap - (camera.optical_gap - camera.gap)
