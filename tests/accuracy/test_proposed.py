"""What exact rays propose as the uncertainty of a first-order model."""

from dataclasses import replace
from pathlib import Path

import pytest

from flflab.accuracy.lenses import plano_convex_microlens
from flflab.accuracy.proposed import glass_of, proposals
from flflab.built_in import Kind, built_in
from flflab.files.camera import read_camera
from flflab.optics.camera import Camera

FOCUS, RADIUS, INDEX = 506.7016, 0.422, 1.46


@pytest.fixture
def camera() -> Camera:
    return read_camera(built_in(Kind.CAMERA))


def seen_through(camera: Camera, aperture: float) -> Camera:
    return replace(camera, array=replace(camera.array, aperture=aperture))


@pytest.mark.ci
def test_first_order_is_proposed_to_hold_where_apertures_are_small(camera: Camera) -> None:
    """Spherical aberration blurs by the cube of an aperture."""
    microlens = plano_convex_microlens(RADIUS, INDEX)
    narrow, wide = (
        proposals(microlens, [(seen_through(camera, aperture), FOCUS)])[0]
        for aperture in (0.03, 0.3)
    )
    assert narrow.contrast < 0.003 < 0.03 < wide.contrast
    assert narrow.pitch == pytest.approx(wide.pitch, rel=0.1)  # the main lens's distortion


@pytest.mark.ci
def test_a_camera_twice_as_large_has_the_same_shares(camera: Camera) -> None:
    lens, array, sensor = camera.main_lens, camera.array, camera.sensor
    large = replace(
        camera,
        main_lens=replace(lens, focal_length=2 * lens.focal_length),
        array=replace(
            array, distance=2 * array.distance, aperture=2 * array.aperture,
            pitch=(2 * array.pitch[0], 2 * array.pitch[1]),
            focal_lengths=tuple(2 * focal for focal in array.focal_lengths),
        ),
        sensor=replace(sensor, distance=2 * sensor.distance, pixel=2 * sensor.pixel),
    )  # fmt: skip
    one = proposals(plano_convex_microlens(RADIUS, INDEX, 0.5), [(camera, FOCUS)])
    two = proposals(plano_convex_microlens(2 * RADIUS, INDEX, 1.0), [(large, 2 * FOCUS)])
    assert [this.shares for this in one] == [this.shares for this in two]


def test_a_camera_file_without_radius_and_index_proposes_nothing(tmp_path: Path) -> None:
    plain = built_in(Kind.CAMERA).read_text(encoding="utf-8")
    file = tmp_path / "camera.yaml"
    file.write_text(plain, encoding="utf-8")
    assert glass_of(file) is None
    glass = "radius_of_curvature: 0.422 mm\n  refractive_index: 1.46\n  focal_length: 0.917 mm"
    file.write_text(plain.replace("focal_length: 0.917 mm", glass), encoding="utf-8")
    found = glass_of(file)
    assert found is not None
    assert (found.curvature[0], found.index[0]) == pytest.approx((1 / 0.422, 1.46))
