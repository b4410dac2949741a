"""Pictures say what they show: labelled axes with units, lines that survive a grey printout."""

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from mishutter import HannShutter, ParabolicMotion, RectShutter, StillCamera, plots
from mishutter.restoration import RestoredPhotograph

MOTION = ParabolicMotion(acceleration=2.3e5, half_exposure=0.0061)
DESIGNS = {
    "rect": (MOTION, RectShutter()),
    "Hann": (MOTION, HannShutter()),
    "snapshot": (StillCamera(half_exposure=0.0013), RectShutter()),
}


def photograph(level, num_seeds=3):
    """A made-up result of a restoration, of a picture wider than it is high."""
    generator = np.random.default_rng(int(level))
    light = generator.uniform(0.1, 0.9, (3, 23, 31, 1))
    error = np.full(3, np.nan if num_seeds == 1 else 0.04)
    return RestoredPhotograph(
        speeds=np.array([-310.0, 0.0, 450.0]),
        psnr=level + np.array([0.3, 1.1, 0.7]),
        linear_psnr=level + np.array([2.3, 3.1, 2.7]),
        standard_error=error,
        linear_standard_error=error,
        mean_psnr=level,
        expected_psnr=level + 0.2,
        reference=light[1],
        captured=light * 0.6,
        restored=light,
    )


FIGURES = {
    "profiles": lambda: plots.plot_profiles(DESIGNS),
    "kernels": lambda: plots.plot_kernels(DESIGNS, [0.0, 700.0]),
    "transfer": lambda: plots.plot_transfer(DESIGNS, [0.0, 700.0]),
    "psnr": lambda: plots.plot_psnr({"rect": photograph(21), "Hann": photograph(24)}),
    "history": lambda: plots.plot_history(jnp.array([0.7, 0.4, 0.3])),
}


@pytest.fixture(scope="module")
def figures():
    return {name: make() for name, make in FIGURES.items()}


@pytest.mark.parametrize("name", FIGURES)
def test_axes_are_labelled(name, figures):
    """Every panel says what is up; the lowest says what is across, with its unit."""
    panels = figures[name].axes
    assert all(axes.get_ylabel() for axes in panels)
    assert panels[-1].get_xlabel()
    if name != "history":
        assert "/ " in panels[-1].get_xlabel()


@pytest.mark.parametrize("name", ["profiles", "transfer"])
def test_lines_differ_in_style(name, figures):
    """Two lines of a panel are told apart without colour."""
    for axes in figures[name].axes:
        lines = [str(line._unscaled_dash_pattern) for line in axes.get_lines()]
        assert len(set(lines)) == len(DESIGNS)


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_a_whole_png(name, figures, tmp_path):
    """A saved figure opens as a picture and leaves nothing else in its folder."""
    path = tmp_path / f"{name}.png"
    plots.save_figure(figures[name], path)
    with Image.open(path) as picture:
        assert min(picture.size) > 300
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_photograph_side_by_side(tmp_path):
    """One column a design beside the scene, at the tried speed nearest to the one asked for."""
    results = {"rect": photograph(21), "Hann": photograph(24)}
    figure = plots.plot_photograph(results, 400.0, crop=(11, 17))
    titles = [axes.get_title() for axes in figure.axes]
    assert "450 px/s" in titles[1]
    assert "restored, 24.7 dB\n(gamma put back)" in titles
    linear = plots.plot_photograph(results, 400.0, crop=(11, 17), linear=True)
    assert linear.axes[-1].get_title() == "restored, 26.7 dB\n(linear light)"
    plots.save_figure(figure, tmp_path / "photograph.png")


def test_one_seed_has_no_error_bar():
    """Without a second capture there is no standard error, and no bar stands for it."""
    figure = plots.plot_psnr({"rect": photograph(21, num_seeds=1)}, linear=True)
    assert not figure.axes[0].collections


@pytest.mark.parametrize(
    ("speeds", "shown"),
    [
        ([-900.0, 0.0, 300.0, 900.0], [0.0, 300.0, 900.0]),
        ([-900.0, -300.0, 0.0, 300.0, 900.0], [0.0, 300.0, 900.0]),
        ([-2550.0, -1500.0, -450.0], [-450.0, -1500.0, -2550.0]),
        ([-700.0, 200.0], [200.0, -700.0]),
        ([410.0], [410.0]),
    ],
)
def test_speeds_that_are_shown(speeds, shown):
    """The slowest, a middling and the fastest by size, each once, as the scene has them."""
    assert plots.shown_speeds(np.array(speeds)) == shown


def test_nothing_to_show_is_an_error():
    """A photograph of no design is refused."""
    with pytest.raises(ValueError, match="must hold a result; got 0"):
        plots.plot_photograph({}, 0.0)
