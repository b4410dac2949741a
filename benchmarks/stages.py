"""What does a stage of limited bandwidth cost, by what is sent to it?"""

from benchmarks import harness
from benchmarks.scenes import scenes
from mishutter import Design, RectShutter, Scene, SecondOrderStage, evaluate, optimise

BANDWIDTHS = (20.0, 50.0, 100.0, 200.0, 1000.0)
DAMPINGS = (0.7, 0.1)
_SCENES = ("built-in", "slow, long", "slides")
NOTE = (
    "Expected PSNR, dB, of the design and of what a stage of second order makes of it, which is "
    "sent the path where the sensor shall be; the same ahead by the stage's delay; and what "
    "`stage.csv` says to send (`sent_position`), which makes the design. The run-up takes the "
    "acceleration of the exposure, as there is no other limit."
)


def designs(scene: Scene) -> dict[str, Design]:
    """The best parabolas of a shaped and of an open shutter."""
    return {
        "parabola, shaped": optimise(scene),
        "parabola, open": optimise(scene, shutter=RectShutter()),
    }


def row(scene: Scene, design: Design, stage: SecondOrderStage) -> dict:
    """Levels of a design on a stage, by what is sent to it; dB."""
    path = scene.limits.stage_path(design.motion)
    if path is None:
        raise ValueError("a design whose sensor moves was expected")
    sent = {"its path": 0.0, "ahead": stage.delay}
    made = {name: stage.made_of(path, ahead=ahead) for name, ahead in sent.items()}
    levels = {name: evaluate(scene, motion, design.shutter) for name, motion in made.items()}
    return {
        "bandwidth Hz": f"{float(stage.bandwidth):g}",
        "damping": f"{float(stage.damping):g}",
        "delay ms": f"{stage.delay * 1e3:.2f}",
        **{name: f"{float(level.expected_psnr):.2f}" for name, level in levels.items()},
        "sent_position": f"{float(design.metrics.expected_psnr):.2f}",
    }


def main() -> None:
    """Measure, store and print."""
    import jax

    jax.config.update("jax_enable_x64", True)
    rows = []
    for name, scene in scenes().items():
        if not name.startswith(_SCENES):
            continue
        for kind, design in designs(scene).items():
            for bandwidth in BANDWIDTHS:
                for damping in DAMPINGS:
                    stage = SecondOrderStage(bandwidth=bandwidth, damping=damping)
                    head = {"scene": name, "design": kind}
                    rows.append(head | row(scene, design, stage))
            print(*rows[-len(BANDWIDTHS) * len(DAMPINGS) :], sep="\n", flush=True)
    harness.write("stages", rows)
    text = harness.table(rows, list(rows[0]))
    harness.section("stages", f"## Stages of limited bandwidth\n\n{NOTE}\n\n{text}")


if __name__ == "__main__":
    main()
