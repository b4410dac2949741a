"""How large is the worst error in each regime of the domain?

The same random points and the same allowances as the tests, sorted by regime; an entry is
the worst error over the allowed one, so 1 is the bound.
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
from support import helpers  # noqa: E402

from benchmarks import harness  # noqa: E402

SLUGS = ("hann", "flutter", "spline", "tukey", "gaussian-narrow")
TRANSFER = {
    "transfer function": helpers.transfer_error,
    "its derivatives": helpers.transfer_derivative_error,
}
NUM_POINTS = {"float64": 400, "float32": 200}


def measure() -> list[dict]:
    """A row a regime and precision."""
    rows = []
    for precision, count in NUM_POINTS.items():
        dtype, rng, worst = np.dtype(precision).type, np.random.default_rng(23), {}
        for index in range(count):
            point = helpers.random_point(rng, dtype, SLUGS[index % len(SLUGS)])
            nothing = {"points": 0, "taps": 0.0, "derivatives": 0.0}
            nothing |= dict.fromkeys(("transfer function", "its derivatives"))
            entry = worst.setdefault(point.regime, nothing)
            taps, derivatives = helpers.computed(point)
            truth = helpers.exact_taps(point)
            entry["points"] += 1
            entry["taps"] = max(entry["taps"], helpers.tap_error(taps, point, truth))
            frequencies = helpers.random_frequencies(rng, point)
            for column, error_of in TRANSFER.items():
                entry[column] = max(entry[column] or 0.0, error_of(point, frequencies))
            for column, argument in enumerate(helpers.ARGUMENTS):
                if index % 5 or (argument == "position" and helpers.edge_at_vertex(point)):
                    continue
                error = helpers.derivative_error(derivatives[:, column], point, argument, truth)
                entry["derivatives"] = max(entry["derivatives"], error)
        rows += [{"precision": precision, "regime": k, **v} for k, v in sorted(worst.items())]
    return rows


def main() -> None:
    """Measure, store and print."""
    rows = measure()
    harness.write("accuracy", rows)
    text = "## Accuracy: worst error of each regime, in units of what is promised\n\n"
    columns = ["precision", "regime", "points", "taps", "derivatives", *TRANSFER]
    harness.section("accuracy", text + harness.table(rows, columns))


if __name__ == "__main__":
    main()
