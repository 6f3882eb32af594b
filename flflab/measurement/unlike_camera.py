"""What a white picture shows unlike the camera's description."""

from flflab.measurement.lattice.lattice import Lattice
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.optics.camera import Camera
from flflab.remark import Remark

RADIUS_TOLERANCE = 0.05  # a measured radius that differs more from the camera's is remarked on
PITCH_TOLERANCE = 0.01  # the same of the pitch


def unlike_the_camera(lattice: Lattice, camera: Camera) -> list[Remark]:
    """Remarks on pitch and radii that are not the camera's.

    Args:
        lattice: measured.
        camera: as described.
    """
    nominal, remarks = nominal_lattice(camera, 1.0), list[Remark]()
    if abs(lattice.pitch_px / nominal.pitch_px - 1) > PITCH_TOLERANCE:
        remarks.append(
            Remark(
                "pitch-unlike-camera",
                f"the pitch is {lattice.pitch_px:.2f} px, the camera's description makes it"
                f" {nominal.pitch_px:.2f} px; check pitch, pixel and distances",
            )
        )
    inside = lattice.inside_radius_px, nominal.inside_radius_px, lattice.inside_uncertainty_px
    outside = lattice.outside_radius_px, nominal.outside_radius_px, lattice.outside_uncertainty_px
    for name, (found, due, doubt) in (("inside", inside), ("outside", outside)):
        if abs(found - due) > max(RADIUS_TOLERANCE * due, 4 * doubt, 0.5):
            remarks.append(
                Remark(
                    "radius-unlike-camera",
                    f"the {name} radius is {found:.2f} px, the camera's description makes it"
                    f" {due:.2f} px; check f-number, apertures and distances",
                )
            )
    return remarks
