r"""What does steepest descent buy beside a sum over quadrature nodes, up to 0.5 cycles/px?

`transfer_function` against the sum $\sum_q w_q e^{-2\pi i f x_q}$ over `exposure_quadrature`, with
as many nodes as the motion needs, and both against 300 digits: the worst error over speeds of 0,
0.3 and 0.9 of the sensor's greatest, in units of what `transfer_function` promises, so 1 is the
bound. Run `python -m benchmarks.spectrum`.
"""

import jax

jax.config.update("jax_enable_x64", True)

from collections.abc import Callable  # noqa: E402
from dataclasses import replace  # noqa: E402
from typing import Any  # noqa: E402

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from support import helpers  # noqa: E402

from benchmarks import harness  # noqa: E402
from mishutter import transfer_function  # noqa: E402
from mishutter.blur import exposure_quadrature  # noqa: E402

SLUGS = ("hann", "tukey", "gaussian", "flutter")
STROKES = (10.0, 100.0, 1e3, 1e4)
"""px."""
SPEEDS = (0.0, 0.3, 0.9)
"""In the sensor's greatest speed."""
FREQUENCIES = (0.013, 0.11, 0.31, 0.5)
HALF_EXPOSURE = 0.0137
PHASE_PER_NODE = 1.45
"""Radians; a plan allows 1.6."""


def num_nodes(stroke: float, speed: float) -> int:
    """Nodes for the fastest turn of the phase at 0.5 cycles/px."""
    fastest = 2 * stroke * (1 + speed)
    return int(np.ceil(2 * np.pi * 0.5 * 2 * fastest / PHASE_PER_NODE)) + 400


def summed(count: int) -> Callable[..., jax.Array]:
    """A sum over `count` nodes, to be called as `transfer_function`."""

    def transfer(shutter: Any, motion: Any, *, speed: Any, frequency: Any) -> jax.Array:
        nodes = exposure_quadrature(shutter, count, np.dtype(frequency.dtype))
        position = motion.position_of(nodes.tau, speed)

        def one(f: jax.Array) -> jax.Array:
            angle = 2 * jnp.pi * f * position
            cosine, sine = (jnp.sum(nodes.weight * x) for x in (jnp.cos(angle), jnp.sin(angle)))
            return jax.lax.complex(cosine, -sine)

        return jax.lax.map(one, frequency)

    return transfer


def measure() -> list[dict]:
    """A row a precision, shutter and stroke."""
    rows = []
    for precision in ("float64", "float32"):
        dtype: Any = np.dtype(precision).type
        rng = np.random.default_rng(3)
        frequencies = np.array(FREQUENCIES, dtype)
        for slug in SLUGS:
            for stroke in STROKES:
                worst: dict[str, float] = {}
                for speed in SPEEDS:
                    T = dtype(HALF_EXPOSURE)
                    a = dtype(stroke / float(T) ** 2)
                    s = dtype(speed * 2 * float(a) * float(T))
                    motion = {"acceleration": a, "half_exposure": T, "speed": s}
                    point = helpers.random_point(rng, dtype, slug)
                    point = replace(point, stroke=stroke, velocity=dtype(0), **motion)
                    count = num_nodes(stroke, speed)
                    for name, method in (("", transfer_function), (" of sum", summed(count))):
                        helpers.transfer_function = method
                        jax.clear_caches()
                        errors = {
                            "values": helpers.transfer_error(point, frequencies),
                            "slopes": helpers.transfer_derivative_error(point, frequencies),
                        }
                        for kind, error in errors.items():
                            worst[kind + name] = max(worst.get(kind + name, 0.0), error)
                rows.append({"precision": precision, "shutter": slug, "stroke, px": stroke} | worst)
    return rows


def main() -> None:
    """Measure and print."""
    rows = measure()
    print(harness.table(rows, list(rows[0])))


if __name__ == "__main__":
    main()
