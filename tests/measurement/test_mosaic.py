"""Pictures through a mosaic of colour filters, measured as four sub-lattices without
demosaicing.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from flflab.errors import MeasurementError
from flflab.files.raw import RawPicture, read_raw, write_raw
from flflab.image.render import render
from flflab.image.scene import one_plane
from flflab.measurement.as_read import as_read
from flflab.measurement.contrast.curve import fit_contrast
from flflab.measurement.dots.views import count_views
from flflab.measurement.edges.views import measure_edges
from flflab.measurement.lattice.nominal import nominal_lattice
from flflab.measurement.lattice.with_camera import lattice_behind
from flflab.measurement.measure import measure
from flflab.measurement.sensor.mosaic import Mosaic, require_no_filters
from flflab.measurement.sensor.noise import SensorNoise
from flflab.targets import Bars, FourDot

Array = npt.NDArray[np.float64]
RESOLUTION = (760, 520)
FOCUS = 506.7016
FILTERS = np.array([[0.55, 1.0], [1.0, 0.4]])
BLACK = (64, 60, 61, 70)


def read(raw: RawPicture, noise: SensorNoise) -> Mosaic:
    return as_read(raw, None, "white", noise)[0]


def through_filters(image: Array, bits: int, seed: int) -> tuple[RawPicture, SensorNoise]:
    """A raw picture of an image in units of white, whose strongest filter fills three quarters of
    the range.
    """
    full = 2**bits - 1
    noise = SensorNoise(0.3 * full / 4095, 2.0 * full / 4095, 0.0, float(full))
    rng = np.random.default_rng(seed)
    tiled = np.tile(FILTERS, (image.shape[0] // 2, image.shape[1] // 2))
    light = rng.poisson(image * tiled * 0.75 * full / noise.dn_per_electron) * noise.dn_per_electron
    black = np.tile(np.reshape(BLACK, (2, 2)), (image.shape[0] // 2, image.shape[1] // 2))
    read = np.rint(light + black + rng.normal(0, noise.read_noise_dn, image.shape)).clip(0, full)
    return RawPicture(read.astype(np.uint16), "rggb", BLACK, full), noise


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_the_filters_gains_come_out_of_the_picture_itself(brute: Any, bits: int) -> None:
    white = brute.white_picture(RESOLUTION[::-1], "square", 120.0, 0.0, (379.5, 259.5), 40.0, 10.0)
    raw, noise = through_filters(white, bits, 1)
    mosaic = read(raw, noise)
    assert mosaic.gains is not None
    assert mosaic.gains == pytest.approx(FILTERS, rel=2e-3)
    even, evened = mosaic.even()
    inside = even[250:270, 370:390]
    assert inside.mean(axis=(0, 1)) == pytest.approx(0.75 * (2**bits - 1), rel=2e-3)
    assert inside.var() == pytest.approx(float(evened.variance(inside.mean())), rel=0.25)
    assert evened.full_scale_dn > even.max()


def test_contrast_through_filters_is_the_closed_form_within_its_uncertainty(brute: Any) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    _, bars = brute.bars_picture(camera, FOCUS, (0.5, 10.0), 20.0)
    raw, noise = through_filters(bars, 12, 2)
    mosaic = read(raw, noise)
    curve = fit_contrast(
        mosaic.values,
        nominal_lattice(camera, 3000.0),
        camera,
        Bars(),
        FOCUS,
        mosaic.noise,
        mosaic.gains,
    )
    score = (curve.contrast - np.sinc(curve.cycles_per_px)) / curve.uncertainty
    assert np.sqrt(np.mean(score**2)) < 1.6
    assert curve.chi2_per_pixel == pytest.approx(1.0, abs=0.2)
    assert curve.uncertainty.max() < 1e-3


@pytest.mark.ci
def test_a_raw_white_picture_gives_the_same_lattice_as_a_grey_one(
    brute: Any, tmp_path: Path
) -> None:
    camera = brute.camera(4.0, RESOLUTION)
    white = brute.white_picture(
        RESOLUTION[::-1], "square", 245.5825, 0.0, (379.5, 259.5), 72.168, 23.777
    )
    raw, noise = through_filters(white, 14, 3)
    write_raw(tmp_path / "white.dng", raw)
    even, evened = read(read_raw(tmp_path / "white.dng"), noise).even()
    lattice = lattice_behind(camera, even, evened)
    assert lattice.pitch_px == pytest.approx(245.5825, rel=2e-5)
    assert lattice.origin_px == pytest.approx([379.5, 259.5], abs=0.02)
    said = measure(raw, camera)
    assert any("four sub-lattices" in remark for remark in said["remarks"])
    assert said["lattice"]["pitch_px"] == pytest.approx(245.5825, rel=2e-5)


def read_back(image: Array, bits: int, file: Path) -> Mosaic:
    """An image through filters, a raw file and back, ready for the fits."""
    raw, noise = through_filters(image, bits, bits)
    write_raw(file, raw)
    back = read_raw(file)
    assert np.array_equal(back.values, raw.values)
    return read(back, noise)


@pytest.mark.ci
@pytest.mark.parametrize(
    "bits", [12, 16, *(pytest.param(n, marks=pytest.mark.full) for n in (10, 14))]
)
def test_lattice_contrast_dots_and_edges_come_out_of_raw_files_of_any_bits_within_their_uncertainty(
    brute: Any, tmp_path: Path, bits: int
) -> None:
    camera, file = brute.camera(4.0, RESOLUTION), tmp_path / "frame.dng"
    white, bars = brute.bars_picture(camera, FOCUS, (0.5, 10.0), 20.0)
    values, noise = read_back(white, bits, file).even()
    lattice = lattice_behind(camera, values, noise)
    assert np.abs((lattice.origin_px - [379.5, 259.5]) / lattice.origin_uncertainty_px).max() < 4
    assert abs(lattice.pitch_px - 245.5823) < 4 * lattice.pitch_uncertainty_px
    mosaic = read_back(bars, bits, file)
    curve = fit_contrast(
        mosaic.values,
        nominal_lattice(camera, 3000.0),
        camera,
        Bars(),
        FOCUS,
        mosaic.noise,
        mosaic.gains,
    )
    assert (
        np.sqrt(np.mean(((curve.contrast - np.sinc(curve.cycles_per_px)) / curve.uncertainty) ** 2))
        < 2
    )
    wide, target = brute.camera(4.0, (1240, 1240)), FourDot(spacing=4.0)
    values, noise = read_back(
        np.maximum(render(one_plane(wide, target, FOCUS), tolerance=5e-5), 0.0), bits, file
    ).even()
    for dot in count_views(values, nominal_lattice(wide, 3000.0), wide, target, FOCUS, noise):
        landed = brute.landings(wide, FOCUS, target.centres[dot.dot])[1]
        off = np.array(
            [
                centre - landed[int(np.argmin(np.hypot(*(landed - centre).T)))]
                for centre in dot.centres_px
            ]
        )
        assert dot.views >= 4
        assert np.sqrt(np.mean((off / dot.centre_uncertainty_px) ** 2)) < 2
    angle, square = math.radians(5), brute.camera(4.0, (740, 740))
    values, noise = read_back(brute.edges_picture(740, angle), bits, file).even()
    (found,), _ = measure_edges(values, nominal_lattice(square, 3000.0), square, noise)
    edges = found.curve
    truth = np.sinc(edges.cycles_per_px * math.cos(angle)) * np.sinc(
        edges.cycles_per_px * math.sin(angle)
    )
    assert len(found.lenses) == 9
    assert np.abs(edges.mtf - truth).max() < 4 * edges.uncertainty.max() + 1e-4


def test_saturated_pixels_stay_saturated_whatever_their_filter() -> None:
    values = np.full((40, 40), 1000, dtype=np.uint16)
    values[:20:2, ::2] = 4095
    mosaic = read(RawPicture(values, "rggb", BLACK, 4095), SensorNoise(0.3, 2.0, 0.0, 4095.0))
    even, evened = mosaic.even()
    assert evened.saturated(even)[:20:2, ::2].all()
    assert np.count_nonzero(evened.saturated(even)) == 200


def test_light_that_a_filter_does_not_pass_is_named() -> None:
    values = np.full((40, 40), 64, dtype=np.uint16)
    values[::2, 1::2] = values[1::2, ::2] = 3000
    with pytest.raises(MeasurementError, match="r 0, g 1, g 1, b 0"):
        read(RawPicture(values, "rggb", (64, 64, 64, 64), 4095), SensorNoise(0.3, 2.0, 0.0, 4095.0))


def test_a_mosaic_that_nothing_names_is_refused_and_grey_is_not(brute: Any) -> None:
    white = brute.white_picture(RESOLUTION[::-1], "square", 120.0, 0.0, (379.5, 259.5), 40.0, 10.0)
    require_no_filters(white + np.random.default_rng(4).normal(0, 0.01, white.shape))
    with pytest.raises(MeasurementError, match=r"name the mosaic \(--mosaic rggb or bggr\)"):
        require_no_filters(through_filters(white, 12, 4)[0].values.astype(np.float64))
