"""Real lenses from published prescriptions, lengths in mm, for the helium d line (587.6 nm)."""

from flflab.accuracy.thick import Lens

# Catalogue data of a plano-convex singlet of N-BK7, f = 50 mm, curved side towards the target; its
# stop is that vertex, which is also its front principal plane.
PLANO_CONVEX = Lens(curvature=(1 / 25.8, 0.0), gap=(6.0,), index=(1.5168, 1.0))

# Thorlabs AC254-050-A, the maker's prescription: a cemented doublet of N-BAF10 and SF10, f = 50 mm,
# corrected for far targets.
ACHROMAT = Lens(
    curvature=(1 / 33.34, -1 / 22.28, -1 / 291.07), gap=(9.0, 2.5), index=(1.67003, 1.72825, 1.0)
)

# Tronnier, US patent 2,673,491: a double Gauss, F/2, half field 22 degrees, as in W. J. Smith,
# Modern Lens Design (1992), p. 312, scaled to 50 mm.
DOUBLE_GAUSS = Lens(
    curvature=(
        1 / 29.475, 1 / 84.83, 1 / 19.275, 1 / 40.77, 1 / 12.75, 0.0, -1 / 14.495, 1 / 40.77,
        -1 / 20.385, 1 / 437.065, -1 / 39.73,
    ),
    gap=(3.76, 0.12, 4.025, 3.275, 5.705, 4.5, 1.18, 6.065, 0.19, 3.22),
    index=(1.67, 1.0, 1.67, 1.699, 1.0, 1.0, 1.603, 1.658, 1.0, 1.717, 1.0),
    stop=5,
)  # fmt: skip

MAIN_LENSES = {"plano-convex": PLANO_CONVEX, "achromat": ACHROMAT, "double Gauss": DOUBLE_GAUSS}


def plano_convex_microlens(
    radius: float = 0.422, index: float = 1.46, thickness: float = 1.0
) -> Lens:
    """A microlens of the paper's array: the curved side, its stop, towards the main lens, and the
    glass plate that carries it behind.
    """
    return Lens(curvature=(1 / radius, 0.0), gap=(thickness,), index=(index, 1.0))
