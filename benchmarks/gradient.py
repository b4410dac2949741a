"""What does a gradient cost, and how exact is it, against finite differences?

The gradient of a weighted sum of taps by acceleration, half exposure, speed and every
parameter of the shutter, for two shutters; differences over their step.
"""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import mpmath as mp  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks import harness  # noqa: E402
from benchmarks.kernel import NUM_TAPS, SHUTTERS, direction, problems, reference  # noqa: E402
from mishutter import ParabolicMotion, binned_exposure  # noqa: E402

CHOSEN = ("52 chips", "spline")
STEPS = (1e-2, 1e-4, 1e-6, 1e-8)


def total_of(problem):
    """Weighted sum of the taps, as a function of scaled motion and shutter parameters."""
    case, weights = SHUTTERS[problem.slug], direction(NUM_TAPS)
    scale = jnp.array([problem.a, problem.T, problem.s])

    def total(x):
        a, T, s = x[:3] * scale
        motion = ParabolicMotion(acceleration=a, half_exposure=T)
        taps = binned_exposure(case.make(x[3:]), motion, speed=s, edges=problem.edges)
        return jnp.sum(taps * weights)

    return total, np.concatenate([np.ones(3), case.parameters])


def exact(problem, at) -> np.ndarray:
    """The same gradient by the reference, one argument after the other."""
    case = SHUTTERS[problem.slug]
    base = [mp.mpf(float(x)) for x in at]

    def total(x):
        a, T, s = x[0] * problem.a, x[1] * problem.T, x[2] * problem.s
        window, edges = case.window(np.array(x[3:])), problem.edges.tolist()
        taps = reference.exposures(window, a, T, s, edges, from_vertex=False)
        return mp.fsum(h * float(c) for h, c in zip(taps, direction(NUM_TAPS), strict=True))

    def moved(index):
        return lambda x: [total([*base[:index], x, *base[index + 1 :]])]

    return np.array(
        [float(reference.derivative(moved(i), base[i], 1)[0]) for i in range(len(base))]
    )


def differences(total, step):
    """Central differences, all arguments in one batch."""
    evaluate = jax.jit(jax.vmap(total))

    def gradient(x):
        moves = step * jnp.eye(x.size)
        return (evaluate(x[None] + moves) - evaluate(x[None] - moves)) / (2 * step)

    return gradient


def measure() -> list[dict]:
    """A row a method: reverse mode, forward mode, and differences of each step."""
    rows = []
    for problem in (p for p in problems() if p.name in CHOSEN):
        total, at = total_of(problem)
        truth, x = exact(problem, at), jnp.asarray(at)
        methods = [
            ("value alone", 0.0, jax.jit(total)),
            ("ours, reverse", 0.0, jax.jit(jax.grad(total))),
            ("ours, forward", 0.0, jax.jit(jax.jacfwd(total))),
            *(("central differences", h, differences(total, h)) for h in STEPS),
        ]
        for name, step, function in methods:
            result = harness.timed(function, x)
            found = np.asarray(result.pop("value"))
            wrong = np.max(np.abs(found - truth)) / np.max(np.abs(truth))
            error = float("nan") if found.ndim == 0 else float(wrong)
            rows.append(
                {
                    "problem": problem.name,
                    "method": name,
                    "step": step,
                    "error": error,
                    "arguments": at.size,
                    **result,
                }
            )
    return rows


def picture(rows: list[dict]) -> None:
    """Error along x, time along y."""
    figure, panels = plt.subplots(1, 2, figsize=(9, 4), sharey=True, layout="constrained")
    for panel, name in zip(panels, CHOSEN, strict=True):
        for marker, label in zip(
            "o*s", ("ours, reverse", "ours, forward", "central differences"), strict=True
        ):
            chosen = [r for r in rows if (r["problem"], r["method"]) == (name, label)]
            x, y = [r["error"] for r in chosen], [1e3 * r["best_s"] for r in chosen]
            panel.loglog(
                x,
                y,
                marker + "-",
                label=label,
                markersize=9,
                color="black" if "ours" in label else "0.5",
            )
        count = next(r["arguments"] for r in rows if r["problem"] == name)
        panel.set(title=f"{name}, {count} arguments", xlabel="error / largest")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("run time of the gradient, ms")
    panels[0].legend()
    harness.save_picture(figure, "gradient")
    plt.close(figure)


def main() -> None:
    """Measure, store, print and draw."""
    rows = measure()
    harness.write("gradient", rows)
    picture(rows)
    shown = [{**r, "best ms": 1e3 * r["best_s"], "first call s": r["first_s"]} for r in rows]
    columns = ["problem", "method", "step", "arguments", "error", "best ms", "first call s"]
    text = "## Gradient: against finite differences\n\n![gradient](results/gradient.png)\n\n"
    harness.section("gradient", text + harness.table(shown, columns))


if __name__ == "__main__":
    main()
