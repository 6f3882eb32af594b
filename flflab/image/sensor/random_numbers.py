"""Random numbers by counter: every pixel has its own, whatever the order in which pixels are worked
through.

Philox4x32-10 (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC11)
turns a counter and a key, 128 bits each with the words below, into 128 random bits. Here the
counter is (pixel, draw, key 2, key 3) and the key (key 0, key 1): the four words of a key name a
frame or a sensor. Draw 0 of a pixel serves two independent numbers, stream 0 and 1, 64 bits each;
later draws serve the few that reject their first.
"""

import hashlib
import math

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Key = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
Bits = npt.NDArray[np.uint64]

LONGEST = 65536  # rows and columns of a sensor: 16 bits of a pixel's number each
RUN = 512  # pixels whose Poisson numbers are found together, in the cache
LAYERS = 256
# where the ziggurat of 256 equal layers begins its tail (Marsaglia, Tsang, J. Stat. Softw. 5 (8),
# 2000)
TAIL = 3.6541528853610088
UNIT = 2.0**-53
LARGE_MEAN = 5.0  # from here on a Poisson number is found by way of a normal one
FAR = 6.0  # standard deviations within which the bound of the expansion is known
_LOW = np.uint64(0xFFFFFFFF)
_32, _1, _2 = np.uint64(32), np.uint64(1), np.uint64(2)
_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_LAYER, _SIGN = np.uint64(0xFF), np.uint64(0x100)
_STEPS = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)


def noise_key(*parts: object) -> Key:
    """Four words of 32 bits that depend on the representations of these parts and on nothing
    else.
    """
    digest = hashlib.blake2b(
        "|".join(repr(part) for part in parts).encode(), digest_size=16
    ).digest()
    first, second, third, fourth = np.frombuffer(digest, dtype="<u4").astype(np.uint64)
    return first, second, third, fourth


def _ziggurat() -> tuple[Array, Array]:
    """Right edges of the layers of equal area under exp(-x^2 / 2), the base first, and the heights
    at them.
    """
    area = TAIL * math.exp(-TAIL * TAIL / 2) + math.sqrt(math.pi / 2) * math.erfc(
        TAIL / math.sqrt(2)
    )
    edges = [area / math.exp(-TAIL * TAIL / 2), TAIL]
    while len(edges) < LAYERS:
        edges.append(math.sqrt(-2 * math.log(area / edges[-1] + math.exp(-(edges[-1] ** 2) / 2))))
    at = np.array([*edges, 0.0])
    return at, np.exp(-(at**2) / 2)


MOST_COUNTED = 64  # a small mean brings more than this with a probability below 1e-26
INVERSES = 1 / np.maximum(np.arange(MOST_COUNTED + 1), 1)
EDGES, HEIGHTS = _ziggurat()


@numba.njit(
    cache=True, nogil=True, error_model="numpy", inline="always"
)  # a loop round a call of it would not be vectorised
def philox(
    pixel: np.uint64, draw: np.uint64, key: Key
) -> tuple[np.uint64, np.uint64]:  # pragma: no cover - compiled
    """The four words of one block, two by two: words 0 and 1, words 2 and 3, the lower word
    first.
    """
    c0, c1, c2, c3, k0, k1 = pixel, draw, key[2], key[3], key[0], key[1]
    for _ in range(10):
        product, other = _MULTIPLIERS[0] * c0, _MULTIPLIERS[1] * c2
        c0, c1, c2, c3 = (
            (other >> _32) ^ c1 ^ k0,
            other & _LOW,
            (product >> _32) ^ c3 ^ k1,
            product & _LOW,
        )
        k0, k1 = (k0 + _STEPS[0]) & _LOW, (k1 + _STEPS[1]) & _LOW
    return c0 | c1 << _32, c2 | c3 << _32


@numba.njit(cache=True, nogil=True, error_model="numpy")
def draw_bits(
    corner: tuple[int, int], key: Key, first: Bits, second: Bits
) -> None:  # pragma: no cover - compiled
    """Draw 0 of a rectangle of pixels with its corner (row, column): 64 bits for stream 0, 64 other
    ones for stream 1.
    """
    for row in range(len(first)):
        pixel = (corner[0] + row) * LONGEST + corner[1]
        for i in range(first.shape[1]):
            first[row, i], second[row, i] = philox(np.uint64(pixel + i), np.uint64(0), key)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def uniform(bits: np.uint64) -> float:  # pragma: no cover - compiled
    """A number above 0 and below 1 from the upper 53 of 64 bits."""
    return (float(np.int64(bits >> np.uint64(11))) + 0.5) * UNIT


@numba.njit(cache=True, nogil=True, error_model="numpy")
def normals(
    bits: Bits, stream: int, corner: tuple[int, int], key: Key, out: Array
) -> None:  # pragma: no cover - compiled
    """Standard normal numbers of a rectangle of pixels by the ziggurat; exact to the 53 bits of its
    uniform numbers.
    """
    for row in range(len(out)):
        _normal_run(bits[row], stream, (corner[0] + row) * LONGEST + corner[1], key, out[row])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _normal_run(
    bits: Bits, stream: int, pixel: int, key: Key, out: Array
) -> None:  # pragma: no cover - compiled
    """Normal numbers of a row of pixels: of most at once, then of the few outside the inner part of
    their layer.
    """
    for i in range(len(out)):
        layer = bits[i] & _LAYER
        x = uniform(bits[i]) * EDGES[layer]
        signed = -x if bits[i] & _SIGN else x
        out[i] = signed if x < EDGES[layer + _1] else np.nan
    for i in range(len(out)):
        if math.isnan(out[i]):
            out[i] = _other_normal(bits[i], stream, pixel + i, key)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _other_normal(
    bits: np.uint64, stream: int, pixel: int, key: Key
) -> float:  # pragma: no cover - compiled
    """The ziggurat where the first 64 bits fall outside the inner part of their layer."""
    draw = np.uint64(1 + stream)
    while True:
        layer = bits & _LAYER
        x = uniform(bits) * EDGES[layer]
        sign = -1.0 if bits & _SIGN else 1.0
        if x < EDGES[layer + _1]:
            return sign * x
        other, bits = philox(np.uint64(pixel), draw, key)
        draw += _2
        if layer == 0:
            x = TAIL - math.log(uniform(other)) / TAIL
            while -2 * math.log(uniform(bits)) <= (x - TAIL) ** 2:
                other, bits = philox(np.uint64(pixel), draw, key)
                draw += _2
                x = TAIL - math.log(uniform(other)) / TAIL
            return sign * x
        if HEIGHTS[layer] + uniform(other) * (HEIGHTS[layer + _1] - HEIGHTS[layer]) < math.exp(
            -x * x / 2
        ):
            return sign * x


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _probability(count: float, mean: float) -> float:  # pragma: no cover - compiled
    """Probability of this number at this mean: exp(-deviance - Stirling's error) / sqrt(2 pi k)
    (Loader, 2000), directly below 10.
    """
    if count < 10:
        return math.exp(count * math.log(mean) - mean - math.lgamma(count + 1))
    away = (count - mean) / mean
    deviance = mean * ((1 + away) * math.log1p(away) - away)
    square = 1 / (count * count)
    stirling = (1 / 12 - square * (1 / 360 - square * (1 / 1260 - square * (1 / 1680)))) / count
    return math.exp(-deviance - stirling) / math.sqrt(2 * math.pi * count)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _tail(count: float, mean: float, upper: bool) -> float:  # pragma: no cover - compiled
    """Probability of more than ``count``, or of at most ``count``, by its series."""
    at = count + 1 if upper else count
    term = _probability(at, mean)
    total = term
    while term > 1e-17 * total:
        if upper:
            at += 1
            term *= mean / at
        else:
            term *= at / mean
            at -= 1
        total += term
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _exact(count: float, mean: float, w: float) -> float:  # pragma: no cover - compiled
    """The least number whose distribution function reaches that of a standard normal number at w,
    from a guess nearby.
    """
    upper = w > 0
    share = 0.5 * math.erfc(abs(w) / math.sqrt(2))
    while True:
        tail = _tail(count, mean, upper)
        if not (tail <= share if upper else tail >= share):
            count += 1
            continue
        if count == 0:
            return count
        below = _tail(count - 1, mean, upper)
        if not (below <= share if upper else below >= share):
            return count
        count -= 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def poissons(
    means: Array, bits: Bits, corner: tuple[int, int], key: Key, out: Array
) -> None:  # pragma: no cover - compiled
    """Poisson numbers of a rectangle of pixels, of stream 0."""
    normal, terms = np.empty(RUN), np.empty(RUN)
    for row in range(len(out)):
        for start in range(0, out.shape[1], RUN):
            end = min(start + RUN, out.shape[1])
            pixel = (corner[0] + row) * LONGEST + corner[1] + start
            part = slice(start, end)
            _poisson_run(
                means[row, part],
                bits[row, part],
                pixel,
                key,
                normal[: end - start],
                terms[: end - start],
                out[row, part],
            )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _poisson_run(
    means: Array, bits: Bits, pixel: int, key: Key, w: Array, terms: Array, out: Array
) -> None:  # pragma: no cover - compiled
    """Poisson numbers of a run of pixels by inversion: the least whose distribution function
    reaches a uniform number.

    Small means count up. Large ones take the uniform number from a normal w, and the number is the
    whole part of the expansion

        mean + sqrt(mean) w + (2 + w^2) / 6 - (w + w^3 / 2) / (36 sqrt(mean)) + (-8 / 405 + 7 w^2 /
        810 + w^4 / 270) / mean

    (Giles, ACM TOMS 42 (1), 7, 2016, eq. 9 and its next term) wherever a bound of its error leaves
    one whole number; elsewhere the distribution function itself decides, so the number is exact to
    the precision of doubles. ``w`` and ``terms`` are room to work in.
    """
    small = 0
    for i in range(len(out)):
        out[i] = 0.0
        small += means[i] < LARGE_MEAN
    if small < len(out):
        _normal_run(bits, 0, pixel, key, w)
        for i in range(len(out)):
            mean, w1, w2 = max(means[i], LARGE_MEAN), w[i], w[i] * w[i]
            root = math.sqrt(mean)
            by_root = 1 / root
            rest = (-8 / 405 + w2 * (7 / 810 + w2 / 270)) * by_root - w1 * (1 + w2 / 2) / 36
            place = mean + root * w1 + (2 + w2) / 6 + rest * by_root
            doubt = (0.025 + abs(w1) * w2 * w2 / 150) * by_root * by_root * by_root + 1e-15 * mean
            whole = math.floor(place)
            sure = (abs(w1) < FAR) & (place - whole > doubt) & (place - whole < 1 - doubt)
            out[i] = (whole if sure else -1 - max(whole, 0.0)) if means[i] >= LARGE_MEAN else 0.0
        for i in range(len(out)):
            if out[i] < 0:
                out[i] = _exact(-1 - out[i], means[i], w[i])
    if small > 0:
        _count_up(means, bits, w, terms, out)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _count_up(
    means: Array, bits: Bits, left: Array, terms: Array, out: Array
) -> None:  # pragma: no cover - compiled
    """Poisson numbers of the small means among these, all together: a uniform number less the
    probabilities of 0, 1, 2, ...
    """
    for i in range(len(out)):
        part, power = min(means[i], LARGE_MEAN) / 16, 1.0
        for k in range(12, 0, -1):
            power = 1 - power * part * INVERSES[k]
        power *= power
        power *= power
        power *= power
        terms[i] = power * power  # exp(-mean) by its series at a 16th of it
        left[i] = uniform(bits[i]) if means[i] < LARGE_MEAN else -1.0
    for k in range(1, MOST_COUNTED):  # the sum of all terms may fall short of 1 by a roundoff
        going = 0
        for i in range(len(out)):
            left[i] = left[i] - terms[i] if left[i] > terms[i] else -1.0
            out[i] += 1.0 if left[i] > 0 else 0.0
            terms[i] *= means[i] * INVERSES[k]
            going += left[i] > 0
        if going == 0:
            return
