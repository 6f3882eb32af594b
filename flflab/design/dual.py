"""Numbers that carry their derivatives: the model differentiated exactly, by running it (forward
automatic differentiation).

A ``Dual`` stands for an array and its derivatives by several dimensions at once; numpy's functions
that the model uses know it. Where the model has a corner (a smaller of two, an absolute value) the
derivative is that of the branch taken; of counts it is 0.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Dual(np.lib.mixins.NDArrayOperatorsMixin):
    """An array ``value`` of any shape and its derivatives ``slope``, of the same shape with one
    more axis at the end.
    """

    def __init__(self, value: Array, slope: Array) -> None:
        """Take both as they are."""
        self.value, self.slope = (
            np.asarray(value, dtype=np.float64),
            np.asarray(slope, dtype=np.float64),
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the value."""
        return self.value.shape

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        values = [given.value if isinstance(given, Dual) else given for given in inputs]
        if method != "__call__":
            return NotImplemented
        out = kwargs.pop("out", None)
        result = ufunc(*values, **kwargs)
        if ufunc in _PLAIN:
            return result
        rule = _RULES.get(ufunc)
        if rule is None or out is not None:
            return NotImplemented
        slope: Array | float = 0.0
        for given, factor in zip(inputs, rule(result, *values), strict=True):
            if isinstance(given, Dual):
                slope = slope + np.asarray(factor)[..., None] * given.slope
        return Dual(result, slope + np.zeros((*np.shape(result), _width(inputs))))

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        rule = _FUNCTIONS.get(func)
        return NotImplemented if rule is None else rule(*args, **kwargs)


def _width(inputs: Sequence[Any]) -> int:
    return next(given.slope.shape[-1] for given in inputs if isinstance(given, Dual))


def _value(given: Any) -> Any:
    return given.value if isinstance(given, Dual) else given


def _slope(given: Any, width: int) -> Array:
    return given.slope if isinstance(given, Dual) else np.zeros((*np.shape(given), width))


def _where(condition: Any, yes: Any, no: Any) -> Any:
    chosen = np.asarray(_value(condition))
    if not isinstance(yes, Dual) and not isinstance(no, Dual):
        return np.where(chosen, yes, no)
    width = _width([yes, no])
    return Dual(
        np.where(chosen, _value(yes), _value(no)),
        np.where(chosen[..., None], _slope(yes, width), _slope(no, width)),
    )


def _sinc(given: Any) -> Dual:
    x = given.value
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(
            np.abs(x) < 1e-4, -(np.pi**2) * x / 3, (np.cos(np.pi * x) - np.sinc(x)) / x
        )
    return Dual(np.sinc(x), slope[..., None] * given.slope)


_PLAIN: set[Any] = {
    np.greater, np.greater_equal, np.less, np.less_equal, np.equal, np.not_equal, np.isfinite,
    np.isnan, np.logical_not,
    np.bitwise_and, np.bitwise_or, np.invert, np.sign, np.floor, np.ceil,
}  # fmt: skip
_RULES: dict[Any, Callable[..., Sequence[Any]]] = {
    np.add: lambda r, a, b: (np.ones_like(r), np.ones_like(r)),
    np.subtract: lambda r, a, b: (np.ones_like(r), -np.ones_like(r)),
    np.multiply: lambda r, a, b: (b + 0 * r, a + 0 * r),
    np.divide: lambda r, a, b: (1 / b + 0 * r, -r / b),
    np.negative: lambda r, a: (-np.ones_like(r),),
    np.absolute: lambda r, a: (np.sign(a),),
    np.minimum: lambda r, a, b: (np.where(a <= b, 1.0, 0.0), np.where(a <= b, 0.0, 1.0)),
    np.maximum: lambda r, a, b: (np.where(a >= b, 1.0, 0.0), np.where(a >= b, 0.0, 1.0)),
    np.sqrt: lambda r, a: (0.5 / r,),
    np.cos: lambda r, a: (-np.sin(a),),
    np.sin: lambda r, a: (np.cos(a),),
    np.arctan: lambda r, a: (1 / (1 + np.square(a)),),
    np.log: lambda r, a: (1 / a,),
    np.exp: lambda r, a: (r,),
    np.power: lambda r, a, n: (n * np.power(a, n - 1), np.zeros_like(r)),
    np.square: lambda r, a: (2 * a,),
}
_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.sinc: _sinc,
    np.ones_like: lambda given: np.ones_like(given.value),
    np.zeros_like: lambda given: np.zeros_like(given.value),
    np.all: lambda given: np.all(_value(given)),
    np.any: lambda given: np.any(_value(given)),
    np.shape: lambda given: given.shape,
}


def dimensions(values: Sequence[float]) -> list[Dual]:
    """Numbers of which each is one of the dimensions to differentiate by, each of shape (1,)."""
    count = len(values)
    return [Dual(np.array([value]), np.eye(count)[[index]]) for index, value in enumerate(values)]
