"""A configuration as a camera file, ready for ``flflab model`` and the bench."""

from flflab.design.grid import Candidates, LensPart
from flflab.design.requirements import Requirements


def camera_text(given: Candidates, lens: LensPart, wanted: Requirements, title: str) -> str:
    """The YAML of one configuration; lengths to the nanometre.

    Args:
        given: one configuration.
        lens: its main lens.
        wanted: the requirements it answers.
        title: what the first line says.
    """
    array, sensor = given.array, given.sensor
    place, gap = float(given.place[0]), float(given.gap[0])
    return f"""# {title}
# Main lens: {lens.name}. Array: {array.name}. Sensor: {sensor.name}.
main_lens:
  focal_length: {lens.focal_length:.6f} mm
  f_number: {float(given.f_number[0]):g}
microlens_array:
  layout: square
  count: [{array.count[0]}, {array.count[1]}]
  pitch: {array.pitch:.6f} mm
  aperture: {array.aperture:.6f} mm
  focal_length: {array.focal_length:.6f} mm
  distance: {place:.6f} mm
sensor:
  resolution: [{sensor.resolution[0]}, {sensor.resolution[1]}]
  pixel: {sensor.pixel:.6f} mm
  distance: {place + gap:.6f} mm
useful:
  minimum_illumination: {wanted.minimum_illumination:g}
"""
