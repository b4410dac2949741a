"""The gallery: a design for each of the scenes that the benchmarks compare, with pictures."""

from pathlib import Path

from benchmarks.scenes import scenes
from mishutter import Design, Scene, compare, example_picture, optimise, restore_photograph
from mishutter.report.documents import Report
from mishutter.report.plots import (
    motion_text,
    plot_kernels,
    plot_photograph,
    plot_profiles,
    save_figure,
)

_ROWS = slice(200, 300)
"""Rows of the photograph that are captured: enough to look at."""
_SHOWN = 3
"""Designs in a picture of photographs."""
_OWN = "optimised"
_HEAD = """\
# Gallery

One design for each of six scenes, searched for when this page was built. [Six scenes](scenes.md)
says which cameras they stand for. Each design stands beside the best snapshot and the best of its
rivals, each at its own best motion. The photograph is captured with the scene's noise at half of
the fastest speed and at the fastest, and restored by one filter that does not know the speed.
"""


def write_gallery(folder: Path) -> None:
    """Search a design for each scene, and write the page with its pictures."""
    (folder / "gallery").mkdir(parents=True, exist_ok=True)
    parts = [
        _entry(name, scene, f"gallery/{number}", folder)
        for number, (name, scene) in enumerate(scenes().items(), 1)
    ]
    (folder / "gallery.md").write_text("\n".join([_HEAD, *parts]))


def _entry(name: str, scene: Scene, stem: str, folder: Path) -> str:
    design = optimise(scene)
    comparison = compare(scene, design)
    shown = Report(scene, comparison, (_OWN,), every=True).rows.items()
    rows = dict([(name, row) for name, row in shown if row.is_of_one_exposure][:_SHOWN])
    designs = {name: (row.motion, row.shutter) for name, row in rows.items()}
    fastest = float(scene.max_speed)
    light = example_picture().light[_ROWS]
    restored = {
        name: restore_photograph(light, scene, *of, speeds=[fastest / 2, fastest], num_seeds=1)
        for name, of in designs.items()
    }
    figures = {
        "levels": comparison.plot(),
        "photograph": plot_photograph(restored, [fastest / 2, fastest]),
        "profile": plot_profiles(designs),
        "kernels": plot_kernels({_OWN: designs[_OWN]}, [0.0, fastest / 2, fastest]),
    }
    names = ", ".join(designs)
    words = {
        "levels": "The level of each option, and the ceiling of one exposure",
        "photograph": f"A part of a photograph, captured, restored, and its error, by: {names}",
        "profile": f"Transmittance over the exposure of: {names}",
        "kernels": "Blur kernels of the design at three speeds",
    }
    for kind, figure in figures.items():
        save_figure(figure, folder / f"{stem}_{kind}.png")
    verdict = "".join(f"    {line}\n" for line in comparison.verdict.splitlines())
    pictures = "\n\n".join(f"![{words[kind]}]({stem}_{kind}.png)" for kind in figures)
    return f"## {name[0].upper()}{name[1:]}\n\n{verdict}\n{_facts(scene, design)}\n\n{pictures}\n"


def _facts(scene: Scene, design: Design) -> str:
    slowest, fastest = float(scene.speeds.min()), float(scene.speeds.max())
    return (
        f"Speeds {slowest:,.0f} to {fastest:,.0f} px/s, {float(scene.photon_rate):.3g} e-/s at "
        f"white, read noise {float(scene.read_noise):g} e-. Design: {motion_text(design.motion)}, "
        f"the stage accelerates at {float(design.motion.greatest_acceleration):.4g} px/s²."
    )
