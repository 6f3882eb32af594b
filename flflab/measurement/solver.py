"""The damped steps of least squares whose normal equations their model adds up itself."""

from collections.abc import Callable
from typing import TypeVar

State = TypeVar("State")
Step = Callable[[float], State]

FIRST, LEAST, MOST = 1e-4, 1e-9, 1e6  # damping, relative to the diagonal of the normal matrix
EASED, RAISED = 0.1, 10.0


def settle(
    start: State, look: Callable[[State], tuple[float, Step[State]]], close: float, most: int
) -> State:
    """Where chi squared is least (Levenberg and Marquardt): a step is taken only if it helps.

    Args:
        start: where to begin.
        look: chi squared of a state, and where a step from there leads with so much damping.
        close: fall of chi squared below which the fit has ended.
        most: looks at most.
    """
    (cost, step), damping = look(start), FIRST
    for _ in range(most):
        trial = step(damping)
        lower, onward = look(trial)
        if lower < cost:
            gained, start, cost, step = cost - lower, trial, lower, onward
            damping = max(damping * EASED, LEAST)
            if gained < close:
                break
        elif damping < MOST:
            damping *= RAISED
        else:
            break
    return start
