r"""How well measurements tell the numbers of a camera, and what they do not see.

The information matrix of the last round of a fit gives the error bars, and its directions of
almost no information say what the measurements do not see. Where it does not hold as far as two
error bars, they are those of the profile likelihood.
"""

from dataclasses import dataclass

import numpy as np

from mishutter.hardware.calibration.likelihood import Setting, Solution, Ties, solved

_RANGE = 12**-0.5
"""Standard deviation of a number anywhere from 0 to 1: how far what is not seen may stray."""
_MAX_ENDS = 3
"""How often a fit goes on from a lower end that a pull has found."""
_STRAIGHT = 0.5
"""Departure of the residuals from what derivatives say, two error bars off, that is none.

It moves an error bar by a quarter at most, and by far less where it is spread over the levels.
"""
_SAME = 0.01
"""Rise of chi squared by which an end of the minimiser is no better than another."""
_LEAST_SEEN = 1 / 3
WIDEST = 1 / 3
"""Error bar of a parameter that is told, at most, in its own scale."""


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Error bars of the parameters, in their own scales, and of the delay.

    Attributes:
        errors: Of each parameter, infinite where it is blind; shape `(n,)`.
        delay: Of the delay; s.
        blind: Directions of almost no information; shape `(k, n)`.
    """

    errors: np.ndarray
    delay: float
    blind: np.ndarray


def error_bars(setting: Setting, solution: Solution) -> tuple[Solution, ErrorBars]:
    r"""The last round of a fit, in which nothing that is seen is tied, and error bars at its end.

    The information matrix tells how $\chi^2$ rises nearby. Farther off it rises otherwise where
    information depends on what was found: a jump of the profile at an end of the exposure tells
    the stage from the shutter the better the higher it is. Each number of the camera is therefore
    pulled either way, everything else following, until $\chi^2$ is about 4 higher. With $\theta$
    there, an error bar is at least $|\theta - \hat\theta|/\sqrt{\Delta\chi^2}$ (the profile
    likelihood's, of the farther side), and no end of less than 1 more lies outside it.
    """
    noise = setting.noise(solution.expected)
    _, unseen = _information(solution.matrix)
    ties = Ties(unseen / _RANGE, unseen @ solution.values / _RANGE)
    values, best, ends = solution.values, solution, []
    for _ in range(_MAX_ENDS):
        best = solved(setting, values, noise, ties)
        ends = _pulled(setting, best, ties)
        lowest = min(ends, key=lambda each: each.loss, default=best)
        if lowest.loss >= best.loss - _SAME:
            break
        values = lowest.values
    everything, blind = _information(best.matrix)
    seen, _ = _information(np.concatenate([best.matrix, ties.rows]))
    late, slopes = setting.delay(best.values)
    numbers = np.concatenate([np.eye(best.values.size), slopes[None]])
    linear, total = (
        np.einsum("ij,jk,ik->i", numbers, each, numbers) for each in (seen, everything)
    )
    bars = np.sqrt(linear)
    for end in ends:
        away = np.append(end.values - best.values, setting.delay(end.values)[0] - late)
        bars = np.maximum(bars, np.abs(away) / np.sqrt(max(end.loss - best.loss, 1.0)))
    *errors, delay = np.sqrt(bars**2 + np.maximum(total - linear, 0))
    return best, ErrorBars(np.array(errors), float(delay), blind)


def _pulled(setting: Setting, best: Solution, ties: Ties) -> list[Solution]:
    """Ends of pulls by 4 error bars on each number of the camera, against its own bar.

    Where information does not change, a pull ends half-way. If residuals there are what
    derivatives say, Fisher's error bar stands, and there is no pull. It starts there, or at the
    best fit where that is nearer to its end.
    """
    everything, _ = _information(best.matrix)
    covariance, _ = _information(np.concatenate([best.matrix, ties.rows]))
    is_own = np.arange(best.values.size) < 4 + len(setting.coefficients)
    is_told = np.diag(everything) <= WIDEST**2
    ends = []
    for k in np.flatnonzero(is_own & is_told & ~setting.is_pinned):
        row = np.eye(best.values.size)[k] / np.sqrt(covariance[k, k])
        for side in (-2, 2):
            away = side * covariance @ row
            there = setting.residuals(best.values + away, best.noise)
            if np.linalg.norm(there - best.residual - best.matrix @ away) > _STRAIGHT:
                pull = row, float(row @ best.values) + 2 * side
                is_nearer = np.sum(there**2) + 2**2 < np.sum(best.residual**2) + 4**2
                start = best.values + away * is_nearer
                ends.append(solved(setting, start, best.noise, ties, pull))
    return ends


def _information(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance by the Fisher information, in the parameters' own scales, and blind directions.

    A direction in which the error bar exceeds a third of that scale is blind. What is not seen at
    all is given three of it, ten of its range, so that it does not spread to what is seen.
    """
    _, singular, directions = np.linalg.svd(matrix, full_matrices=False)
    bars = directions / np.maximum(singular, _LEAST_SEEN)[:, None]
    return bars.T @ bars, directions[singular <= 1 / WIDEST]
