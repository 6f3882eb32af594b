"""How far pictures of random scenes are from the slow reference by rays: ``python
benchmarks/random_scenes.py [SCENES] [FIRST_SEED]``.

Each scene is formed to the default tolerance with every effect but diffraction, and a few of its
lit pixels are traced one by one. Kept is the promise where at least 95 % of the scenes are within
their tolerance and the others within three times it. Scenes formed by rays may state more than was
asked for, where 256 rays a pixel do not do: such a statement is their tolerance.
"""

import sys
from dataclasses import replace

import numpy as np
from reference_rays.pixels import trace_pixels
from reference_rays.random_scene import random_scene

from flflab.image.accuracy import TOLERANCE
from flflab.image.render import render, render_light
from flflab.image.scene import ALL

RESOLUTION = (48, 36)
PIXELS = 12
UNSURE = TOLERANCE / 5  # standard uncertainty of a traced pixel


def error_of(seed: int) -> tuple[str, float] | None:
    """By which path a scene is formed, and its error over what is promised; None where it is dark.

    The error is the root mean square over the pixels, less that of the reference's uncertainties.
    """
    scene = replace(random_scene(np.random.default_rng([seed, 9]), RESOLUTION), diffraction=None)
    light = render_light(scene, TOLERANCE, ALL)
    lit = np.argwhere(light.image > 0)
    if not len(lit):
        return None
    chosen = lit[np.random.default_rng(seed).integers(0, len(lit), PIXELS)]
    mean = float(render(replace(scene, stray_light=None, colour_filter=None)).mean())
    traced, unsure = trace_pixels(scene, chosen[:, ::-1], wanted=UNSURE, mean_light=mean)
    squares = (light.image[chosen[:, 0], chosen[:, 1]] - traced) ** 2 - unsure**2
    rms = float(np.sqrt(max(np.mean(squares), 0.0)))
    return light.path, rms / max(TOLERANCE, light.pilot.rms if light.pilot else 0.0)


def main() -> None:
    """Print a line a scene, and the shares at the end."""
    given = [int(word) for word in sys.argv[1:]]
    count, first = [*given, *(300, 0)[len(given) :]]
    found: list[float] = []
    for seed in range(first, first + count):
        error = error_of(seed)
        if error is None:
            print(f"{seed:4d}  dark", flush=True)
            continue
        found.append(error[1])
        print(f"{seed:4d}  {error[0]:12s}  {error[1]:.3f} of the tolerance", flush=True)
    errors = np.array(found)
    print(
        f"{len(errors)} lit scenes: {100 * np.mean(errors <= 1):.1f} % within the tolerance, worst"
        f" {errors.max():.2f}, median {np.median(errors):.3f} of it"
    )


if __name__ == "__main__":
    main()
