"""Which way to the blur kernel is quickest at a given error, for value and for gradient?

Typical printout, on two cores of an Intel Xeon: see `RESULTS.md`.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import mpmath as mp  # noqa: E402
import numpy as np  # noqa: E402
import reference  # noqa: E402
from cases import SHUTTERS  # noqa: E402

from benchmarks import harness  # noqa: E402
from benchmarks.rivals import Method, Problem, methods  # noqa: E402

NUM_TAPS = 64
DESIGN_TAPS, DESIGN_SPEEDS = 192, 9
"""What a design computes in one call: a kernel at each of its speeds."""
MARKERS = "osv^<>DPX*"


def problems(num_taps: int = NUM_TAPS) -> list[Problem]:
    """The five kinds of problem, each over the whole of its support."""

    def problem(name, slug, stroke, smear, T=0.02):
        edges = np.linspace(-_behind(stroke, smear), stroke + abs(smear), num_taps + 1) + 0.013
        a, s = stroke / T**2, smear / T
        return Problem(name, slug, SHUTTERS[slug].shutter(), a, T, s, edges)

    return [
        problem("smooth shutter", "hann", 45.0, 27.0),
        problem("52 chips", "flutter", 60.0, 24.0),
        problem("spline", "spline", 45.0, -27.0),
        problem("near-zero acceleration", "hann", 1e-7, 26.0),
        problem("faster than the sensor", "hann", 4.0, 80.0),
    ]


def _behind(stroke, smear):
    return smear**2 / (4 * stroke) if abs(smear) < 2 * stroke else abs(smear) - stroke


def direction(num_taps: int = NUM_TAPS) -> np.ndarray:
    """Weights of the taps in the scalar whose gradient is taken."""
    return np.cos(1.3 * np.arange(num_taps) + 0.2)


def exact(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Taps, and the gradient of their weighted sum by a, T, s, by the reference."""
    window = SHUTTERS[problem.slug].reference()
    at = (problem.a, problem.T, problem.s)

    def taps(*motion):
        edges = problem.edges.tolist()
        return reference.exposures(window, *motion, edges, from_vertex=False)

    def by(index):
        def moved(x):
            weighted = zip(taps(*at[:index], x, *at[index + 1 :]), direction(), strict=True)
            return [mp.fsum(h * float(c) for h, c in weighted)]

        return reference.derivative(moved, at[index], abs(at[index]))[0]

    return np.array([float(h) for h in taps(*at)]), np.array([float(by(i)) for i in range(3)])


def gradient_of(method: Method):
    """Gradient of the weighted sum of a method's taps by a, T and s."""
    weights = direction()

    def total(motion):
        return jnp.sum(method.taps(*motion) * weights)

    if method.compiled:
        return jax.jit(jax.grad(total))

    def differences(motion):
        steps = 1e-6 * np.diag(motion)
        return np.array([(total(motion + d) - total(motion - d)) / (2 * d.sum()) for d in steps])

    return differences


def measure(problem: Problem) -> list[dict]:
    """A row a method and setting: time and error of value and of gradient."""
    taps, gradient = exact(problem)
    motion = np.array([problem.a, problem.T, problem.s])
    rows = []
    for method in methods(problem):
        value = jax.jit(method.taps) if method.compiled else method.taps
        for what, function, arguments, truth in (
            ("value", value, tuple(motion), taps),
            ("gradient", gradient_of(method), (motion,), gradient * motion),
        ):
            row = {"problem": problem.name, "method": method.name, "knob": method.knob}
            try:
                if what == "gradient" and method.name == "quadax" and problem.slug != "hann":
                    raise NotImplementedError("not run: minutes to compile")
                result = harness.timed(function, *arguments)
                found = np.asarray(result.pop("value"), float)
                found = found if what == "value" else found * motion
                error = float(np.max(np.abs(found - truth)) / np.max(np.abs(truth)))
            except Exception as problem_met:
                result, error = harness.failed(problem_met), float("nan")
            rows.append({**row, "what": what, "error": error, **result})
    return rows


def measure_design(problem: Problem) -> list[dict]:
    """The same at the size of a design, for what is compiled: every speed in one call.

    The error is the value's, from ours in float64, which is the first method.
    """
    speeds = problem.s * np.linspace(-1, 1, DESIGN_SPEEDS)
    arguments = np.concatenate([[problem.a, problem.T], speeds])
    rows, truth = [], None
    for method in methods(problem):
        if not method.compiled or method.name == "quadax":
            continue
        every = jax.vmap(method.taps, in_axes=(None, None, 0))

        def value(x, every=every):
            return every(x[0], x[1], x[2:])

        def total(x, value=value):
            return jnp.sum(value(x) * direction(DESIGN_TAPS))

        taps = harness.timed(jax.jit(value), arguments)
        found = np.asarray(taps.pop("value"), float)
        truth = found if truth is None else truth
        error = float(np.max(np.abs(found - truth)) / np.max(truth))
        gradient = harness.timed(jax.jit(jax.grad(total)), arguments)
        gradient.pop("value")
        row = {"problem": problem.name, "method": method.name, "knob": method.knob}
        rows += [{**row, "what": "value", "error": error, **taps}]
        rows += [{**row, "what": "gradient", **gradient}]
    return rows


def picture(rows: list[dict]) -> None:
    """Error along x, time along y; a method is a marker of its own, ours are filled."""
    names = list(dict.fromkeys(row["problem"] for row in rows))
    labels = list(dict.fromkeys(row["method"] for row in rows))
    figure, panels = plt.subplots(
        2, len(names), figsize=(15, 6.4), sharex=True, sharey=True, layout="constrained"
    )
    for (line, what), (column, name) in (
        (i, j) for i in enumerate(("value", "gradient")) for j in enumerate(names)
    ):
        panel = panels[line, column]
        for index, label in enumerate(labels):
            chosen = [
                r for r in rows if (r["problem"], r["what"], r["method"]) == (name, what, label)
            ]
            x = [max(r["error"], 1e-17) for r in chosen]
            y = [1e3 * r["best_s"] for r in chosen]
            mine = label.startswith("ours")
            panel.loglog(
                x,
                y,
                MARKERS[index] + ("" if mine else "-"),
                label=label,
                color="black" if mine else plt.cm.viridis(index / len(labels)),
                markerfacecolor="black" if mine else "white",
                markersize=9 if mine else 6,
            )
        panel.set_title(name if line == 0 else "")
        panel.grid(alpha=0.3)
    for line, what in enumerate(("value", "gradient")):
        panels[line, 0].set_ylabel(f"run time of the {what}, ms")
    for panel in panels[1]:
        panel.set_xlabel("error / largest")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    harness.save_picture(figure, "kernel")
    plt.close(figure)


def main() -> None:
    """Measure, store, print and draw."""
    rows: list[dict] = []
    for problem in problems():
        rows += measure(problem)
        harness.write("kernel", rows, num_taps=NUM_TAPS)
        print(f"kernel: {problem.name} done", file=sys.stderr)
    picture(rows)
    design = [row for problem in problems(DESIGN_TAPS) for row in measure_design(problem)]
    harness.write("kernel", rows, num_taps=NUM_TAPS, design_rows=design)
    columns = ["problem", "what", "method", "knob", "error", "best ms", "first call s"]
    text = "## Kernel: run time against error\n\n![kernel](results/kernel.png)\n\n"
    text += harness.table(_shown(rows), [*columns, "why"])
    text += f"\n\nThe same, {DESIGN_SPEEDS} speeds of {DESIGN_TAPS} taps in one call, as a design "
    text += "computes them;\nerrors of values, from ours in float64:\n\n"
    harness.section("kernel", text + harness.table(_shown(design), columns))


def _shown(rows: list[dict]) -> list[dict]:
    return [{**r, "best ms": 1e3 * r["best_s"], "first call s": r["first_s"]} for r in rows]


if __name__ == "__main__":
    main()
