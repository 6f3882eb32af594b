"""The regime of a scene: the few numbers from which follows how much each effect can matter. Only
numbers; ``survey`` finds them.

Angles are on the object side, o / D of a place o on the target; at infinity they are the target's
own coordinates.
"""

import math
from dataclasses import dataclass

# a stretch of the rays about their middle changes a pixel by so many times what an even shift of
# them does
UNEVEN = math.pi


@dataclass(frozen=True)
class PlaneRegime:
    """What matters of one target, the worst microlens and pixel each.

    Attributes:
        distance: main lens to target, mm.
        blur: largest diameter of the blur of a point, pixels.
        least_blur: smallest one.
        field: largest angle off the axis from which a ray reaches the sensor, rad.
        from_centre: the same off the target's centre.
        bundle: half the angle over which the rays of one pixel are spread, rad.
        pixel_angle: smallest angle that one pixel sees, rad; 0 where the target's image lies on the
            array.
        contrast: range of the light with the target's radiance, of white.
        steepness: most that a pixel changes when the target moves by 1 rad, of white.
        plain: whether the radiance varies along one direction only.
    """

    distance: float
    blur: float
    least_blur: float
    field: float
    from_centre: float
    bundle: float
    pixel_angle: float
    contrast: float
    steepness: float
    plain: bool

    def moved(self, shift: float, stretch: float = 0.0) -> float:
        """Most that a pixel changes, of white, when all its rays move evenly by ``shift`` and apart
        by ``stretch``, rad.
        """
        far = shift + UNEVEN * stretch
        return min(self.contrast, self.steepness * far) if far > 0 else 0.0

    def pixels(self, angle: float) -> float:
        """An angle as seen on the sensor, pixels."""
        return (
            angle / self.pixel_angle if self.pixel_angle > 0 else (math.inf if angle > 0 else 0.0)
        )


@dataclass(frozen=True)
class Change:
    """What becomes of the microlenses when they change places or focal lengths.

    Attributes:
        rim: how far the rims move on the sensor, pixels.
        shift: how far the rays of a pixel move evenly, rad.
        stretch: how far they move apart at each plane's distance, rad.
        level: relative change of the light.
    """

    rim: float = 0.0
    shift: float = 0.0
    stretch: float = 0.0
    level: float = 0.0


@dataclass(frozen=True)
class Regime:
    """A scene in numbers, the worst microlens and pixel each.

    Attributes:
        planes: the targets.
        pixel: side of the sensor's pixels, mm.
        pixels: how many there are.
        lit: share of them that light can reach.
        microlenses: how many send light to the sensor.
        light: brightest light under white targets, of white, the light of neighbours included; an
            upper bound.
        brightest: the same under the scene's targets.
        reaching: micro-images that reach a pixel, at most.
        rim: width of the widest rim, pixels.
        least_rim: of the narrowest.
        rim_steepness: most that a pixel changes when the rims move by one pixel, of white.
        gap: from one micro-image to the next, pixels; negative where they overlap.
        crosstalk: most light that neighbours bring to a pixel, of white.
        airy: radius of the Airy disc on the sensor for light of 1 mm wavelength, pixels.
        slope: largest slope of a ray at the sensor.
        misaligned: what the camera's offsets, roll and tilt change.
        scattered: what the scatter of the microlenses changes.
        electrons: mean electrons in a pixel at the white level; 0 where no sensor was asked for.
    """

    planes: tuple[PlaneRegime, ...]
    pixel: float
    pixels: int
    lit: float
    microlenses: int
    light: float
    brightest: float
    reaching: int
    rim: float
    least_rim: float
    rim_steepness: float
    gap: float
    crosstalk: float
    airy: float
    slope: float
    misaligned: Change
    scattered: Change
    electrons: float = 0.0

    @property
    def blur(self) -> float:
        """Largest blur of all targets, pixels."""
        return max(plane.blur for plane in self.planes)

    @property
    def field(self) -> float:
        """Largest angle off the axis, rad."""
        return max(plane.field for plane in self.planes)

    def of_white(self, electrons: float) -> float:
        """So many electrons as a share of the white level; infinite where no sensor counts them."""
        if electrons == 0:
            return 0.0
        return electrons / self.electrons if self.electrons > 0 else math.inf

    def changed(self, change: Change) -> float:
        """Most that a pixel changes by this, of white."""
        rays = sum(plane.moved(change.shift, change.stretch) for plane in self.planes)
        return min(
            self.light,
            rays + self.rim_steepness * change.rim * UNEVEN + change.level * self.brightest,
        )
