r"""Error bars of a fitted camera, and the directions in which it is not identifiable.

The information matrix of the last round of a fit gives both: the error bars, and directions of
almost no information. Where the residuals are not linear as far as two error bars, the error bars
are those of the profile likelihood.
"""

import numpy as np
from jaxtyping import Float

from mishutter.hardware.calibration.likelihood import RANGE, Setting, Solution, Ties

WIDEST = 1 / 3
"""Greatest error bar of an identifiable parameter, in its own scale."""


def error_bars(
    setting: Setting, solution: Solution
) -> tuple[Solution, Float[np.ndarray, "n"], float, Float[np.ndarray, "k n"]]:
    r"""The last round of a fit, which ties blind directions alone, and error bars at its end.

    They are those of the parameters in their own scales, which are not identifiable above `WIDEST`,
    and that of the delay, s; the directions of almost no information are the last.

    The information matrix gives the rise of $\chi^2$ nearby. Farther off the rise is another where
    information depends on the camera: a jump of the profile at an end of the exposure tells the
    stage from the shutter the better the higher it is. Each parameter of the camera is therefore
    pulled either way, everything else following, until $\chi^2$ is about 4 higher. With $\theta$
    there, an error bar is at least $|\theta - \hat\theta|/\sqrt{\Delta\chi^2}$ (the profile
    likelihood's, of the farther side), and an end whose $\chi^2$ rises by less than 1 lies within
    it.
    """
    noise = setting.noise(solution.expected)
    _, blind = _information(solution.matrix)
    ties = Ties(blind / RANGE, blind @ solution.values / RANGE)
    values, best, ends = solution.values, solution, []
    # A last round begins again at a lower end that a pull has found, twice at most.
    for _ in range(3):
        best = setting.solved(values, noise, ties)
        ends = _pulled(setting, best, ties)
        lowest = min(ends, key=lambda each: each.loss, default=best)
        if lowest.loss >= best.loss - 0.01:
            break
        values = lowest.values
    untied, blind = _information(best.matrix)
    tied, _ = _information(np.concatenate([best.matrix, ties.rows]))
    delay, slopes = setting.delay(best.values)
    rows = np.concatenate([np.eye(best.values.size), slopes[None]])
    linear, total = (
        np.einsum("ij,jk,ik->i", rows, covariance, rows) for covariance in (tied, untied)
    )
    bars = np.sqrt(linear)
    for end in ends:
        distance = np.append(end.values - best.values, setting.delay(end.values)[0] - delay)
        bars = np.maximum(bars, np.abs(distance) / np.sqrt(max(end.loss - best.loss, 1.0)))
    *errors, delay_error = np.sqrt(bars**2 + np.maximum(total - linear, 0))
    return best, np.array(errors), float(delay_error), blind


def _pulled(setting: Setting, best: Solution, ties: Ties) -> list[Solution]:
    """Ends of pulls on each parameter of the camera, whose residuals are not linear.

    A pull is a tie, one error bar wide, to a value 4 error bars off. With linear residuals it would
    end half-way, 2 error bars off: Fisher's error bar then stands, and there is no pull. Other
    pulls start half-way, or at the best fit if the sum of squares, the tie's included, is lower
    there. A departure of 0.5 from linear residuals counts as none: it moves an error bar by a
    quarter at most, and by far less where it is spread over the levels.
    """
    untied, _ = _information(best.matrix)
    covariance, _ = _information(np.concatenate([best.matrix, ties.rows]))
    is_shared = np.arange(best.values.size) < 4 + len(setting.coefficients)
    is_identifiable = np.diag(untied) <= WIDEST**2
    ends = []
    for k in np.flatnonzero(is_shared & is_identifiable & ~setting.is_pinned):
        row = np.eye(best.values.size)[k] / np.sqrt(covariance[k, k])
        for side in (-2, 2):
            step = side * covariance @ row
            residual = setting.residuals(best.values + step, best.noise)
            if np.linalg.norm(residual - best.residual - best.matrix @ step) > 0.5:
                pull = row, float(row @ best.values) + 2 * side
                is_lower = np.sum(residual**2) + 2**2 < np.sum(best.residual**2) + 4**2
                start = best.values + step * is_lower
                ends.append(setting.solved(start, best.noise, ties, pull))
    return ends


def _information(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance by the Fisher information, in the parameters' own scales, and blind directions.

    A direction is blind where its error bar exceeds a third of that scale. No error bar exceeds
    three of it, ten standard deviations of its range, which prevents the uncertainty of parameters
    without information from spreading to others.
    """
    _, singular, directions = np.linalg.svd(matrix, full_matrices=False)
    bars = directions / np.maximum(singular, 1 / 3)[:, None]
    return bars.T @ bars, directions[singular <= 1 / WIDEST]
