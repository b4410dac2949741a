"""`python -m benchmarks`: every benchmark, and `RESULTS.md` from what they printed."""

import importlib
import sys

from benchmarks import harness

ALL = (
    "accuracy",
    "kernel",
    "free_path",
    "gradient",
    "design",
    "ablation",
    "command",
    "compiles",
    "scaling",
    "stress",
    "capture",
    "photographs",
    "by_decoder",
    "borders",
    "monte_carlo",
    "occlusion",
    "gains",
    "bursts",
    "plane",
    "bursts_search",
    "many_frames",
    "bursts_photographs",
    "plane_photographs",
    "trust",
    "layered_loss",
    "layered_photographs",
    "layered_bursts",
    "strips",
    "moving_objects",
    "object_velocities",
    "objects",
    "footage",
    "rolling",
    "kinds",
    "restoration",
    "restoration_over_speeds",
    "speed",
    "scenes",
    "tolerances",
    "devices",
    "slots",
    "stages",
    "independent",
    "told",
    "alignment",
    "cross_motion",
    "long_kernels",
    "fit",
    "measure",
    "plan",
    "sweep",
    "explore",
)


def assemble() -> None:
    """Write `RESULTS.md` from the sections that exist."""
    kept = [harness.RESULTS / f"{name}.md" for name in ALL]
    machine = harness.environment()
    head = (
        "# Results\n\nWritten by `python -m benchmarks`; every sample is in `results/`.\n"
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, "
        f"jax {machine['versions']['jax']}, double precision unless said otherwise; load "
        f"{machine['load']:.1f} when written. Times are the least of up to 1,000 runs.\n"
    )
    sections = [path.read_text("utf-8") for path in kept if path.exists()]
    (harness.RESULTS.parent / "RESULTS.md").write_text("\n".join([head, *sections]))


def main() -> None:
    """Run those named on the command line, or all."""
    others = sorted(set(sys.argv[1:]) - set(ALL))
    if others:
        raise SystemExit(f"benchmarks must be some of {', '.join(ALL)}; got {', '.join(others)}.")
    for name in sys.argv[1:] or ALL:
        importlib.import_module(f"benchmarks.{name}").main()
    assemble()


if __name__ == "__main__":
    main()
