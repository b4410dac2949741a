"""How do time and memory traffic grow with taps, speeds and designs?

Value and gradient of the kernel of a 24-coefficient spline, over four decades of each,
beside two measured floors:

- the operations that must run: for each edge a square root, and on each branch of the path the
  piece of the shutter looked up and its antiderivative there. Their difference is the light of
  a tap, with as many digits lost as a tap is short;
- the arithmetic of that alone, with nothing looked up: a square root and two cubics a tap.
"""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks import harness  # noqa: E402
from mishutter import ParabolicMotion, SplineShutter, blur_kernel  # noqa: E402
from mishutter.model.shutters.spline import bezier_extraction  # noqa: E402

PARAMETERS = 0.5 + 0.4 * np.sin(1.7 * np.arange(24))
BASE = {"taps": 64, "speeds": 1, "designs": 1}
COUNTS = {
    "taps": (10, 100, 1000, 10_000, 100_000),
    "speeds": (1, 10, 100, 1000, 10_000),
    "designs": (1, 10, 100, 1000, 10_000),
}
MEMORY = 1e8
"""Bytes; a batch that needs more is run in slices, which then stay near the caches."""


def kernel_sum(parameters, speed, taps):
    """A scalar of one kernel, so that value and gradient can be compared."""
    motion = ParabolicMotion(acceleration=0.8 * taps, half_exposure=1.0)
    kernel = blur_kernel(SplineShutter(parameters), motion, speed=speed, num_taps=taps)
    return jnp.sum(kernel**2)


def batched(function, axis, count, taps):
    """`function` over the axis under study, in slices that fit memory."""
    slice_size = max(1, int(MEMORY / (2 * taps * 8 * 80)))
    parameters, speeds = jnp.asarray(PARAMETERS), jnp.linspace(-0.3, 0.3, max(count, 2))
    if axis == "taps":
        return jax.jit(lambda: function(parameters, 0.2, taps))
    if axis == "speeds":
        return jax.jit(
            lambda: jax.lax.map(
                lambda s: function(parameters, s, taps), speeds[:count], batch_size=slice_size
            )
        )
    designs = parameters[None] + 1e-3 * jnp.sin(jnp.arange(count * 24.0)).reshape(count, 24)
    return jax.jit(
        lambda: jax.lax.map(lambda p: function(p, 0.2, taps), designs, batch_size=slice_size)
    )


def least_sum(parameters, speed, taps):
    """`kernel_sum` by differences of the antiderivative: what no method can do without."""
    rise = _antiderivative(parameters)
    num_pieces = rise.shape[0]

    def light_until(tau):
        position = (jnp.clip(tau, -1, 1) + 1) * (num_pieces / 2)
        piece = jnp.minimum(position.astype(jnp.int32), num_pieces - 1)
        share, c = position - piece, rise.at[piece].get(mode="promise_in_bounds")
        return (((c[:, 4] * share + c[:, 3]) * share + c[:, 2]) * share + c[:, 1]) * share + c[:, 0]

    stroke = 0.8 * taps
    root = jnp.sqrt(jnp.arange(taps + 1.0) / stroke)
    middle = speed / (2 * stroke)
    return jnp.sum(jnp.diff(light_until(middle + root) - light_until(middle - root)) ** 2) / 4


def _antiderivative(parameters):
    """Coefficients of the light up to a share of each piece; shape `(pieces, 5)`."""
    control = jnp.asarray(bezier_extraction(parameters.size)) @ parameters
    powers = jnp.array([[1.0, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]])
    cubic = control @ powers.T
    within = cubic / jnp.array([1.0, 2, 3, 4]) * (2 / control.shape[0])
    whole = jnp.sum(within, axis=1)
    return jnp.column_stack([jnp.cumsum(whole) - whole, within])


def arithmetic(count, what):
    """One square root and two cubics a tap, or their gradient; and the numbers it takes."""

    def work(cubic, speed, x):
        root = jnp.sqrt(x)
        light = sum(
            ((cubic[3] * t + cubic[2]) * t + cubic[1]) * t + cubic[0]
            for t in (speed + root, speed - root)
        )
        return jnp.sum(light**2)

    function = work if what == "value" else jax.grad(work, argnums=(0, 1))
    cubic, x = jnp.array([0.1, -0.7, 0.2, 0.3]), jnp.linspace(0.1, 0.9, count)
    return jax.jit(function), cubic, jnp.asarray(0.2), x


def measure() -> list[dict]:
    """A row a size; the other sizes stay at their base."""
    rows = []
    for axis, counts in COUNTS.items():
        for count in counts:
            taps = count if axis == "taps" else BASE["taps"]
            total = taps * (1 if axis == "taps" else count)
            for what in ("value", "gradient"):
                ours, least = kernel_sum, least_sum
                if what == "gradient":
                    ours, least = (jax.grad(f, argnums=(0, 1)) for f in (ours, least))
                row = {"axis": axis, "count": count, "what": what}
                try:
                    result = harness.timed(batched(ours, axis, count, taps))
                    result.pop("value")
                except Exception as met:
                    result = harness.failed(met)
                row["floor_s"] = harness.timed(batched(least, axis, count, taps))["best_s"]
                row["arithmetic_s"] = harness.timed(*arithmetic(total, what))["best_s"]
                rows.append({**row, **result})
    return rows


def picture(rows: list[dict]) -> None:
    """Time against size on logarithmic axes; a straight line of slope one is linear."""
    figure, panels = plt.subplots(1, 3, figsize=(12, 4), sharey=True, layout="constrained")
    for panel, axis in zip(panels, COUNTS, strict=True):
        for what, style in (("value", "ko-"), ("gradient", "ks--")):
            chosen = [r for r in rows if (r["axis"], r["what"]) == (axis, what)]
            x = [r["count"] for r in chosen]
            panel.loglog(x, [1e3 * r["best_s"] for r in chosen], style, label=what)
            least = [1e3 * r["floor_s"] for r in chosen]
            line = ":" if what == "value" else "-."
            panel.loglog(x, least, line, color="0.5", label=f"floor, {what}")
        panel.set_xlabel(f"number of {axis}")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("run time, ms")
    panels[0].legend(loc="upper left")
    harness.save_picture(figure, "scaling")
    plt.close(figure)


def main() -> None:
    """Measure, store, print and draw."""
    rows = measure()
    harness.write("scaling", rows, base=BASE)
    picture(rows)
    shown = [
        {
            **r,
            "best ms": 1e3 * r["best_s"],
            "floor ms": 1e3 * r["floor_s"],
            "times": r["best_s"] / r["floor_s"],
            "arithmetic ms": 1e3 * r["arithmetic_s"],
            "times that": r["best_s"] / r["arithmetic_s"],
        }
        for r in rows
    ]
    columns = ["axis", "count", "what", "best ms", "floor ms", "times"]
    columns += ["arithmetic ms", "times that", "why"]
    text = "## Scaling: taps, speeds, designs\n\n![scaling](results/scaling.png)\n\n"
    harness.section("scaling", text + harness.table(shown, columns))


if __name__ == "__main__":
    main()
