"""Other ways to the same taps, each with its own knob, as the field writes them.

All take `(a, T, s)` and give the exposure between the edges of a problem. Those in JAX are
compiled whole; roots are the textbook ones, which is part of what is compared.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import quadax
import scipy.integrate

from mishutter import AbstractShutter, ParabolicMotion, binned_exposure
from mishutter.model.shutters.base import piecewise

PASSING_TIMES = "passing times alone"


class Problem(NamedTuple):
    """A shutter, a motion and edges; `slug` names the shutter among the test cases."""

    name: str
    slug: str
    shutter: AbstractShutter
    a: float
    T: float
    s: float
    edges: np.ndarray


class Method(NamedTuple):
    """A way to the taps: its name, its knob's setting and `taps(a, T, s)`."""

    name: str
    knob: float
    taps: Callable
    compiled: bool = True


def ours(problem: Problem, dtype: type[np.floating] = np.float64) -> Method:
    """The package, in a given precision."""
    cast = jax.tree.map(lambda x: jnp.asarray(x, dtype), problem.shutter)
    edges = problem.edges.astype(dtype)

    def taps(a, T, s):
        a, T, s = (jnp.asarray(x, dtype) for x in (a, T, s))
        motion = ParabolicMotion(acceleration=a, half_exposure=T)
        return binned_exposure(cast, motion, speed=s, edges=edges)

    return Method(f"ours, {np.dtype(dtype).name}", 0, taps)


def _intervals(problem: Problem, a, T, s, edges=None):
    """Times at which the point is inside each tap, on both branches; two of shape `(2, n)`."""
    A, B = a * T * T, s * T
    edges = jnp.asarray(problem.edges) if edges is None else edges
    positive = jnp.maximum(B * B + 4 * A * edges, 0)
    root = jnp.where(positive > 0, jnp.sqrt(jnp.where(positive > 0, positive, 1.0)), 0.0)
    before, after = (B - root) / (2 * A), (B + root) / (2 * A)
    lower = jnp.stack([before[1:], after[:-1]])
    upper = jnp.stack([before[:-1], after[1:]])
    return jnp.clip(lower, -1, 1), jnp.clip(upper, -1, 1)


def gauss_legendre(problem: Problem, count: int) -> Method:
    """Fixed rule on each chip's part of each tap."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    ends = np.asarray(piecewise(problem.shutter).breakpoints(np.dtype(np.float64)))

    def taps(a, T, s):
        lower, upper = _intervals(problem, a, T, s)
        lo = jnp.maximum(lower[:, None], ends[None, :-1, None])
        width = jnp.maximum(jnp.minimum(upper[:, None], ends[None, 1:, None]) - lo, 0)
        tau = lo[..., None] + width[..., None] * jnp.asarray((1 + nodes) / 2)[None, None, None]
        light = problem.shutter.transmittance(tau) @ jnp.asarray(weights / 2)
        return jnp.sum(width * light, axis=(0, 1)) / 2

    return Method("Gauss-Legendre per chip", count, taps)


def antiderivative(problem: Problem) -> Method:
    """Closed form: the antiderivative at the ends of each tap, subtracted."""
    primitive = PRIMITIVES[problem.slug](problem.shutter)

    def taps(a, T, s):
        lower, upper = _intervals(problem, a, T, s)
        return jnp.sum(primitive(upper) - primitive(lower), axis=0) / 2

    return Method("closed-form differences", 0, taps)


def passing_times(problem: Problem) -> Method:
    """No rival but a floor: when each edge is passed, which every exact method has to find."""

    def taps(a, T, s):
        lower, upper = _intervals(problem, a, T, s)
        return jnp.sum(upper - lower, axis=0) / 2

    return Method(PASSING_TIMES, 0, taps)


def _hann_primitive(_):
    return lambda t: t / 2 + jnp.sin(jnp.pi * t) / (2 * jnp.pi)


def _chips_primitive(shutter):
    chips = shutter.transmittances
    below = jnp.concatenate([jnp.zeros(1), jnp.cumsum(chips)])
    count = chips.size

    def primitive(t):
        position = (t + 1) * (count / 2)
        chip = jnp.clip(position.astype(jnp.int32), 0, count - 1)
        return (below[chip] + chips[chip] * (position - chip)) * (2 / count)

    return primitive


PRIMITIVES = {"hann": _hann_primitive, "flutter": _chips_primitive}


def frame_sums(problem: Problem, count: int) -> Method:
    """Midpoint frames added up, as simulators do; a position falls in one tap or another."""
    tau = (2 * np.arange(count) + 1) / count - 1

    def taps(a, T, s):
        position = (a * T * T * tau - s * T) * tau
        light = problem.shutter.transmittance(tau) / count
        index = jnp.searchsorted(jnp.asarray(problem.edges), position, side="right") - 1
        size = problem.edges.size - 1
        index = jnp.where(index < 0, size, index)
        return jnp.zeros(size).at[index].add(light, mode="drop")

    return Method("midpoint frame sums", count, taps)


def area_sampled(problem: Problem, parts: int) -> Method:
    """The paper's area integration, the shutter sampled at the centre of each part of a tap."""
    share = np.linspace(0, 1, parts + 1)[:-1]
    fine = (problem.edges[:-1, None] + np.diff(problem.edges)[:, None] * share).reshape(-1)
    fine = np.append(fine, problem.edges[-1])

    def taps(a, T, s):
        lower, upper = _intervals(problem, a, T, s, jnp.asarray(fine))
        light = problem.shutter.transmittance((lower + upper) / 2) * (upper - lower)
        return jnp.sum(light, axis=0).reshape(-1, parts).sum(1) / 2

    return Method("area integration, sampled", parts, taps)


def adaptive(problem: Problem, tolerance: float) -> Method:
    """Quadax's adaptive Gauss-Kronrod rule on each tap."""

    def one(lower, upper):
        ends = jnp.array([lower, upper])
        function = problem.shutter.transmittance
        return quadax.quadgk(function, ends, epsabs=tolerance, epsrel=tolerance)[0]

    def taps(a, T, s):
        lower, upper = _intervals(problem, a, T, s)
        return jnp.sum(jax.vmap(jax.vmap(one))(lower, upper), axis=0) / 2

    return Method("quadax", tolerance, taps)


def scipy_quad(problem: Problem, tolerance: float) -> Method:
    """SciPy's `quad` on each tap, told where the breakpoints are."""
    ends = np.asarray(piecewise(problem.shutter).breakpoints(np.dtype(np.float64)))
    light = jax.jit(lambda tau: problem.shutter.transmittance(tau))
    values = partial(_interpolated, light)

    def taps(a, T, s):
        lower, upper = (np.asarray(x) for x in _intervals(problem, a, T, s))
        total = np.zeros(problem.edges.size - 1)
        for branch, k in np.ndindex(*lower.shape):
            lo, hi = lower[branch, k], upper[branch, k]
            if hi > lo:
                inside = ends[(ends > lo) & (ends < hi)]
                points = np.concatenate([[lo], inside, [hi]])
                for left, right in pairwise(points):
                    total[k] += scipy.integrate.quad(
                        values, left, right, epsabs=tolerance, epsrel=tolerance
                    )[0]
        return total / 2

    return Method("SciPy quad", tolerance, taps, compiled=False)


def _interpolated(light, tau):
    return float(light(tau))


def methods(problem: Problem) -> list[Method]:
    """Every method that a problem admits, each over its knob."""
    found = [ours(problem), ours(problem, np.float32)]
    found += [gauss_legendre(problem, n) for n in (2, 4, 8, 16)]
    if problem.slug in PRIMITIVES:
        found.append(antiderivative(problem))
    found.append(passing_times(problem))
    found += [area_sampled(problem, n) for n in (1, 64)]
    found += [frame_sums(problem, n) for n in (1000, 100_000)]
    found.append(adaptive(problem, 1e-12))
    found.append(scipy_quad(problem, 1e-13))
    return found
