"""Numbers of other people's models: libpleno's initialisation of the R12-A, and its virtual depths."""

import math

import numpy as np
import pytest

from flflab.optics.focus import virtual_depth
from flflab.optics.smms import Smms


def r12a_as_initialised() -> Smms:
    """libpleno, plenoptic.cpp init (Galilean) with F = 50, h = 450, m = 0.1405955..., distances computed by its formulas."""
    focal, total, m = 50.0, 450.0, 0.14059554040431976
    hyperfocal = total / 2 * (1 - math.sqrt(1 - 4 * focal / total))
    gap = 2 * m * hyperfocal / (focal + 4 * m)
    length = hyperfocal - 2 * gap
    numbers = (focal, 12.5, length, gap, 0.55, 0.1275, 0.0, 0.0)
    return Smms(*(np.asarray(number) for number in numbers))


def test_the_initialised_distances_are_the_published_ones() -> None:
    smms = r12a_as_initialised()
    assert float(smms.gap) == pytest.approx(0.31863244257046275, rel=1e-12)
    assert float(smms.distance) == pytest.approx(56.65763680237485, rel=1e-12)
    pitch = 0.12822163189288707 / float(smms.image_scale)
    assert pitch == pytest.approx(0.12750456894191076, rel=1e-12)


# Object distance from the main lens, mm, and virtual depth by libpleno's definition.
VIRTUAL_DEPTHS = [
    (350, 5.259027), (360, 4.415367), (370, 3.624437), (380, 2.881442), (390, 2.182152), (395, 1.847709), (400, 1.522822),
    (392.705098, 2.0), (408.357728, 1.0), (378.362618, 3.0), (365.172403, 4.0), (341.734640, 6.0), (321.541485, 8.0), (303.962804, 10.0),
]  # fmt: skip


@pytest.mark.parametrize(("distance", "depth"), VIRTUAL_DEPTHS)
def test_virtual_depth_agrees_with_libpleno(distance: float, depth: float) -> None:
    assert float(virtual_depth(r12a_as_initialised(), 1 / distance)) == pytest.approx(depth, abs=6e-7)


def test_an_object_at_the_total_distance_has_virtual_depth_two() -> None:
    smms = r12a_as_initialised()
    focal, total = 50.0, 450.0
    hyperfocal = total / 2 * (1 - math.sqrt(1 - 4 * focal / total))
    assert float(virtual_depth(smms, 1 / (total - hyperfocal))) == pytest.approx(2.0, rel=1e-10)
