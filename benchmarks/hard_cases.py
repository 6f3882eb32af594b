"""Where textbook formulas lose their digits and the model does not: prints the table of
docs/model-accuracy.md.

Run by hand: ``python benchmarks/hard_cases.py``. Errors are relative, against 50 digits on the same
doubles; nan and inf are failures.
"""

import math
import sys
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np

from flflab.optics.brightness import irradiance
from flflab.optics.focus import blur, magnification, marginal_angle, virtual_depth
from flflab.optics.overlap import common_area
from flflab.optics.smms import Smms

mp: Any = mpmath
F, A, L, B, SMALL, D_CLEAR = 50.0, 12.5, 60.0, 1.15, 0.917, 0.336
Formula = Callable[..., Any]


def smms(b: float = B, y: float = 0.0, aperture: float = D_CLEAR) -> Smms:
    """The worked example's SMMS, some of it changed."""
    return Smms(*(np.asarray(part) for part in (F, A, L, b, SMALL, aperture, y, 0.0)))


def discs(r1: Any, r2: Any, d: Any, lib: Any = math) -> Any:
    """Textbook: r1^2 acos(...) + r2^2 acos(...) - half the root of Heron's product."""
    one = (d * d + r1 * r1 - r2 * r2) / (2 * d * r1)
    two = (d * d + r2 * r2 - r1 * r1) / (2 * d * r2)
    root = lib.sqrt((-d + r1 + r2) * (d + r1 - r2) * (d - r1 + r2) * (d + r1 + r2))
    return r1 * r1 * lib.acos(one) + r2 * r2 * lib.acos(two) - root / 2


def blur_textbook(D: Any, b: Any = B) -> Any:
    """Textbook: image distance, object distance a of the microlens, d |1 - b/f + b/a|."""
    one = type(D)
    image = 1 / (1 / one(F) - 1 / D)
    a = one(L) - image
    return one(D_CLEAR) * abs(1 - one(b) / one(SMALL) + one(b) / a)


def depth_textbook(D: Any) -> Any:
    """Textbook: v = (L - D') / b with D' = D F / (D - F)."""
    one = type(D)
    return abs(one(L) - D * one(F) / (D - one(F))) / one(B)


def magnification_textbook(D: Any) -> Any:
    """Textbook: (D'/D) (b/a)."""
    one = type(D)
    image = D * one(F) / (D - one(F))
    return image / D * one(B) / abs(one(L) - image)


def angle_textbook(t: Any, g: Any, b: Any, lib: Any = math) -> Any:
    """Textbook: the difference of two arc tangents."""
    return lib.atan((t + g) / b) - lib.atan((t - g) / b)


def share_textbook(t: Any, g: Any, b: Any, lib: Any = math) -> Any:
    """Textbook: (1 - cos) / 2 of the cone."""
    near = b * b + t * t - g * g
    return (1 - near / lib.sqrt(near * near + 4 * b * b * g * g)) / 2


def attempt(job: Callable[[], Any]) -> Any:
    """The value, or nan where the formula fails."""
    try:
        return job()
    except (ZeroDivisionError, ValueError, OverflowError):
        return math.nan


def row(case: str, textbook: Any, ours: float, exact: Any) -> None:
    """One line of the table."""

    def error(value: Any) -> str:
        if math.isnan(float(value)):
            return "fails"
        return f"{float(abs(mp.mpf(float(value)) - exact) / (abs(exact) if exact else 1)):.0e}"

    sys.stdout.write(f"| {case} | {error(textbook)} | {error(ours)} |\n")


def main() -> None:
    """Print the table."""
    sys.stdout.write("| case | textbook formula | here |\n|---|---|---|\n")
    with mpmath.workdps(50):
        for name, r1, r2, d in (
            ("two discs, gap 1e-8 before they part", 1.0, 1.0, 2 - 1e-8),
            ("two discs, 1e-12 before the smaller is swallowed", 1.0, 0.5, 0.5 + 1e-12),
            ("two discs of radii 1 : 1e9", 1.0, 1e9, 1e9),
            ("two nearly coinciding discs, 1e-12 apart", 1.0, 1.0, 1e-12),
        ):  # fmt: skip
            expected = discs(mp.mpf(r1), mp.mpf(r2), mp.mpf(d), mp)
            row(
                name,
                attempt(lambda r1=r1, r2=r2, d=d: discs(r1, r2, d)),
                float(common_area(r1, r2, d)),
                expected,
            )
        for name, D in (
            ("image on the array, blur", 300.0),
            ("image 1e-9 mm off the array, blur", 300.0 * (1 + 1e-10)),
        ):
            V = mp.mpf(1) / mp.mpf(D)
            x = L * (V - mp.mpf(1) / 50 + mp.mpf(1) / 60)
            kappa = 1 + mp.mpf(B) / 60 - mp.mpf(B) / mp.mpf(SMALL)
            expected = abs(kappa * x - mp.mpf(B) / 60) * (
                min(mp.mpf(A), mp.mpf(D_CLEAR) / abs(x)) if x else mp.mpf(A)
            )
            row(name, attempt(lambda D=D: blur_textbook(D)), float(blur(smms(), 1 / D)), expected)
        row(
            "target at infinity, virtual depth",
            attempt(lambda: depth_textbook(math.inf)),
            float(virtual_depth(smms(), 0.0)),
            mp.mpf(10) / mp.mpf(B),
        )
        row(
            "target at infinity, magnification",
            attempt(lambda: magnification_textbook(math.inf)),
            float(magnification(smms(), 0.0)),
            mp.mpf(0),
        )
        for name, y in (
            ("microlens 1e3 pitches off the axis, marginal angle", 400.0),
            ("microlens 1e6 pitches off the axis, marginal angle", 4e5),
        ):
            t, g = y * B / L, D_CLEAR / 2
            expected = angle_textbook(
                mp.mpf(y) * mp.mpf(B) / 60, mp.mpf(D_CLEAR) / 2, mp.mpf(B), mp
            )
            row(name, angle_textbook(t, g, B), float(marginal_angle(smms(y=y))), expected)
        for name, d in (
            ("pinhole of 1 um, irradiance", 1e-3),
            ("pinhole of 1 pm, irradiance", 1e-9),
        ):
            expected = share_textbook(mp.mpf(0), mp.mpf(d) / 2, mp.mpf(B), mp)
            row(
                name,
                attempt(lambda d=d: share_textbook(0.0, d / 2, B)),
                float(irradiance(smms(aperture=d))),
                expected,
            )


if __name__ == "__main__":
    main()
