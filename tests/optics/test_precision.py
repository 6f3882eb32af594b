"""What double precision can give: two discs to 8 units of roundoff, depth of field and three discs
to 8 units of their condition.

The references are computed in 50 digits from the very doubles the model was given. Everyday 20,000
stratified inputs, a million under ``full``; the worst inputs ever met stay in ``WORST_DISCS`` and
are tried first.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest

from flflab.optics.discs import three_disc_area, two_disc_areas
from flflab.optics.focus import depth_of_field
from flflab.optics.illumination import illumination_radius
from flflab.optics.overlap import common_area
from flflab.optics.smms import Smms

Array = npt.NDArray[np.float64]
UNIT = 2.0**-53
mp: Any = mpmath

# (radius, radius, distance): tangent inside and outside, nested, nearly the same, radii 1 : 1e9;
# and the worst of past runs.
WORST_DISCS = [
    (0.0037304605345614230, 1.0, 1.0001799646629874),
    (5.298881996536893e-07, 1.0, 1.0000001526636533),
    (0.1289803261961331, 2.030786489679339e-06, 0.12898095426193035),
    (0.0008370006281762177, 0.03226876211485646, 0.03310576274292224),
    (0.03255886537932174, 1.276606142479952e-06, 0.03255995013817181),
    (1.0, 1.0, 2.0), (1.0, 1.0, math.nextafter(2.0, 0)), (1.0, 1.0, 0.0), (1.0, 1.0, 5e-324),
    (1.0, 1.0, 1e-300),
    (1.0, 0.5, 0.5), (1.0, 0.5, math.nextafter(0.5, 1)), (1.0, 0.5, 1.5),
    (1.0, math.nextafter(1.0, 0), 2.0**-53),
    (1.0, 1e-9, 1.0), (1.0, 1e-9, 1 - 1e-9), (1.0, 1e-9, 1 + 1e-9), (1e9, 1.0, 1e9),
    (3.0, 4.0, 5.0), (1e-150, 1e-150, 1e-150),
    (1e150, 1e150, 1e150), (0.0, 1.0, 0.5), (0.0, 0.0, 0.0),
]  # fmt: skip

# (F, A, L, b, f, d, c): a gap far beyond the main lens's distance, where kappa cancels though the
# result does not.
WORST_CAMERAS = [
    (
        351.7864128723107,
        58.8762474143481,
        1.0363237497000688,
        16.475449438208216,
        9.707556301047898,
        2.8359606600162137,
        2.2199597070787056e-4,
    ),
]


def area_in_50_digits(radius1: float, radius2: float, distance: float) -> Any:
    r1, r2, d = mp.mpf(radius1), mp.mpf(radius2), mp.mpf(distance)
    if d >= r1 + r2:
        return mp.mpf(0)
    if d <= abs(r1 - r2):
        return mp.pi * min(r1, r2) ** 2
    total = mp.mpf(0)
    for r, other in ((r1, r2), (r2, r1)):
        half = mp.atan2(
            mp.sqrt((other - r + d) * (other + r - d)), mp.sqrt((r - other + d) * (d + r + other))
        )
        total += r * r * (2 * half - mp.sin(2 * half) * mp.cos(2 * half))
    return total


def hard_discs(number: int, seed: int) -> Array:
    """Radii down to 1 : 1e9 and distances at, near and between both tangencies, their gaps down to
    the roundoff, shape (number, 3).
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    large = 10.0 ** rng.uniform(-3, 3, number)
    small = large * 10.0 ** np.where(
        rng.random(number) < 0.5, rng.uniform(-9, 0, number), -rng.exponential(1e-6, number)
    )
    gap = 10.0 ** rng.uniform(-17, 0, number)
    distance = np.select(
        [rng.random(number) < 0.35, rng.random(number) < 0.5],
        [(small + large) * (1 - gap), (large - small) + 2 * small * gap],
        (large - small) + rng.uniform(0, 2, number) * small,
    )
    first = rng.random(number) < 0.5
    return np.stack(
        [np.where(first, small, large), np.where(first, large, small), np.maximum(distance, 0.0)],
        axis=1,
    )


def units_off(found: Array, given: Array) -> Array:
    """Relative errors in units of roundoff."""
    off = np.zeros(len(given))
    with mpmath.workdps(60):
        for i, (one, area) in enumerate(zip(given, found, strict=True)):
            expected = area_in_50_digits(*(float(part) for part in one))
            if expected == 0:
                assert area == 0, one
            elif expected > 1e-290:  # below, doubles themselves have fewer digits
                off[i] = float(abs(mp.mpf(float(area)) - expected) / expected) / UNIT
    return off


def batches(number: int) -> Iterator[Array]:
    yield np.array(WORST_DISCS)
    for start in range(0, number, 20_000):
        yield hard_discs(min(20_000, number - start), start + 1)


@pytest.mark.parametrize("area", [common_area, two_disc_areas], ids=["numpy", "kernel"])
@pytest.mark.parametrize(
    "number",
    [
        5_000,
        pytest.param(20_000, marks=pytest.mark.ci),
        pytest.param(1_000_000, marks=[pytest.mark.full, pytest.mark.timeout(3600)]),
    ],
)
def test_two_discs_are_good_to_eight_units_of_roundoff(
    area: Callable[..., Array], number: int
) -> None:
    worst = 0.0
    for given in batches(number):
        off = units_off(area(*given.T), given)
        worst = max(worst, float(off.max()))
        assert off.max() <= 8, given[off.argmax()].tolist()
    assert worst > 0


def stratified_smms(number: int, seed: int) -> tuple[Smms, Array]:
    """Cameras of every kind, a quarter of each: ordinary, near the exit pupil, |kappa| near c/d,
    pinholes; and circles of blur.
    """
    rng = np.random.Generator(np.random.Philox(key=seed))
    kind = rng.integers(0, 4, number)
    focal, length, small = (
        10.0 ** rng.uniform(0, 3, number),
        10.0 ** rng.uniform(0, 3, number),
        10.0 ** rng.uniform(-2, 1, number),
    )
    aperture, microlens = (
        focal / rng.uniform(0.7, 32, number),
        small * 10.0 ** rng.uniform(-2, 0, number),
    )
    circle = 10.0 ** rng.uniform(-4, -1, number)
    gap = small * 10.0 ** rng.uniform(-1, 1, number)
    slope = rng.choice([-1, 0, 1], number) * np.where(
        kind == 2, circle / microlens, 0
    ) + 10.0 ** rng.uniform(-12, -3, number)
    steered = (1 - slope) / (1 / small - 1 / length)
    gap = np.where(((kind == 1) | (kind == 2)) & (steered > 0), steered, gap)
    aperture, microlens = (
        np.where(kind == 3, aperture * 1e-6, aperture),
        np.where(kind == 3, microlens * 1e-6, microlens),
    )
    numbers = np.stack([focal, aperture, length, gap, small, microlens, circle])
    worst = np.array(WORST_CAMERAS).T
    numbers[:, : worst.shape[1]] = worst
    zero = np.zeros(number)
    return (
        Smms(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], zero, zero),
        numbers[6],
    )


@pytest.mark.parametrize("share", [1e-9, 0.01, 0.5, 0.9, 1 - 1e-6])
def test_light_falls_to_a_share_where_two_discs_in_50_digits_do(share: float) -> None:
    smms, _ = stratified_smms(400, 4)
    radii = illumination_radius(smms, share)
    with mpmath.workdps(60):
        for lens, microlens, radius in zip(
            smms.lens_width / 2, smms.microlens_width / 2, radii, strict=True
        ):
            whole = mp.pi * min(mp.mpf(float(lens)), mp.mpf(float(microlens))) ** 2
            places = (float(radius + units * np.spacing(radius)) for units in (-4, 0, 4))
            within, found, beyond = (
                area_in_50_digits(float(lens), float(microlens), place) for place in places
            )
            assert abs(found - share * whole) <= 16 * UNIT * whole + (within - beyond)


def ends(one: Any, sign: int, by_lens: bool) -> Any:
    """One end of the depth of field as a vergence, from (F, A, L, b, f, d, c): exact for whatever
    numbers come in.
    """
    F, A, L, b, f, d, c = one
    kappa = 1 + b / L - b / f
    x = (b / L + sign * c / A) / kappa if by_lens else b / L / (kappa + sign * c / d)
    return 1 / F - (1 - x) / L


def condition(numbers: Array, sign: int, by_lens: bool) -> Array:
    """|result| + sum of |input * derivative|, by complex steps; numbers of shape (7, n)."""
    total = np.abs(ends(numbers, sign, by_lens))
    for index in range(7):
        stepped: list[npt.NDArray[np.complex128]] = [row.astype(np.complex128) for row in numbers]
        stepped[index] = stepped[index] * (1 + 1e-30j)
        total = total + np.abs(np.imag(ends(stepped, sign, by_lens)) / 1e-30)
    return total


@pytest.mark.parametrize(
    "number", [20_000, pytest.param(1_000_000, marks=[pytest.mark.full, pytest.mark.timeout(7200)])]
)
def test_the_ends_of_the_depth_of_field_are_good_to_eight_units_of_their_condition(
    number: int,
) -> None:
    looked_at = 0
    for start in range(0, number, 20_000):
        size = min(20_000, number - start)
        smms, circle = stratified_smms(size, start + 3)
        numbers = np.stack(
            [
                smms.lens_focal,
                smms.lens_aperture,
                smms.distance,
                smms.gap,
                smms.focal,
                smms.aperture,
                circle,
            ]
        )
        names = list(Smms.__dataclass_fields__)
        with np.errstate(divide="ignore", invalid="ignore"):
            bounds = {
                (sign, by_lens): condition(numbers, sign, by_lens)
                for sign in (-1, 1)
                for by_lens in (True, False)
            }
            rough = {key: ends(numbers, *key) for key in bounds}
        with mpmath.workdps(50):
            for i in range(size):
                one = Smms(**{name: np.asarray(getattr(smms, name)[i]) for name in names})
                for piece in depth_of_field(one, float(circle[i])):
                    for end in piece:
                        if end == 0 or not math.isfinite(end):
                            continue
                        excess = []
                        for key, bound in bounds.items():
                            # The same end is computed in 50 digits only where it is anywhere near.
                            if not abs(rough[key][i] - end) <= 1e6 * UNIT * bound[i]:
                                continue
                            exact = ends([mp.mpf(float(part)) for part in numbers[:, i]], *key)
                            excess.append(
                                float(abs(mp.mpf(end) - exact)) / (UNIT * float(bound[i]))
                            )
                        assert excess, numbers[:, i].tolist()
                        assert min(excess) <= 8, numbers[:, i].tolist()
                        looked_at += 1
    assert looked_at > 0.3 * number


def three_discs_in_50_digits(discs: list[tuple[float, float, float]]) -> tuple[Any, Any]:
    """Area common to three discs and sum |input * derivative|: arcs of the boundary by Green's
    formula.
    """
    area = condition_sum = mp.mpf(0)
    exact = [tuple(mp.mpf(part) for part in disc) for disc in discs]
    for index, (x, y, r) in enumerate(exact):
        cuts = [mp.mpf(0), 2 * mp.pi]
        for other, (x2, y2, r2) in enumerate(exact):
            if other == index:
                continue
            d = mp.hypot(x2 - x, y2 - y)
            if abs(r - r2) < d < r + r2:
                middle = mp.atan2(y2 - y, x2 - x)
                half = mp.acos((d * d + r * r - r2 * r2) / (2 * d * r))
                cuts += [mp.fmod(middle + turn + 4 * mp.pi, 2 * mp.pi) for turn in (-half, half)]
        cuts.sort()
        along = across = round_ = mp.mpf(0)
        for a, b in itertools.pairwise(cuts):
            t = (a + b) / 2
            px, py = x + r * mp.cos(t), y + r * mp.sin(t)
            if b > a and all(
                mp.hypot(px - u, py - v) <= w for k, (u, v, w) in enumerate(exact) if k != index
            ):
                area += (
                    r * r * (b - a)
                    + r * x * (mp.sin(b) - mp.sin(a))
                    - r * y * (mp.cos(b) - mp.cos(a))
                ) / 2
                round_ += r * (b - a)
                along += r * (mp.sin(b) - mp.sin(a))
                across -= r * (mp.cos(b) - mp.cos(a))
        condition_sum += abs(r * round_) + abs(x * along) + abs(y * across)
    return area, condition_sum


@pytest.mark.parametrize(
    "number",
    [
        1_000,
        pytest.param(4_000, marks=pytest.mark.ci),
        pytest.param(1_000_000, marks=[pytest.mark.full, pytest.mark.timeout(7200)]),
    ],
)
def test_three_discs_are_good_to_eight_units_of_their_condition(number: int) -> None:
    rng = np.random.Generator(np.random.Philox(key=9))
    worst = 0.0
    with mpmath.workdps(50):
        for _ in range(number):
            radius = 10.0 ** rng.uniform(-1, 0.3, 3)
            place = rng.uniform(-1, 1, (3, 2)) * 10.0 ** rng.uniform(-2, 0.2)
            if rng.random() < 0.3:  # two of them near a tangency
                turn, gap = (
                    rng.uniform(0, 2 * np.pi),
                    10.0 ** rng.uniform(-15, -1) * rng.choice([-1, 1]),
                )
                apart = (
                    radius[0] + radius[1] if rng.random() < 0.5 else abs(radius[0] - radius[1])
                ) + gap
                place[1] = place[0] + apart * np.array([np.cos(turn), np.sin(turn)])
            discs = [
                (float(x), float(y), float(r)) for (x, y), r in zip(place, radius, strict=True)
            ]
            area, spread = three_discs_in_50_digits(discs)
            found = three_disc_area(*(part for disc in discs for part in disc))
            off = (
                float(abs(mp.mpf(found) - area) / (UNIT * (area + spread)))
                if area + spread
                else float(found != 0)
            )
            worst = max(worst, off)
            assert off <= 8, discs
    assert worst > 0
