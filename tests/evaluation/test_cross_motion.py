"""The closed form of motion across the axis, against the model of one axis and a quadrature."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cross_motion
from mishutter import ParabolicMotion, Scene, TukeyShutter, evaluate

STROKE, HALF, TAPER = 39.0, 0.00625, 0.86
CAMERA = cross_motion.Camera(STROKE / HALF**2, HALF, TAPER)


@pytest.mark.parametrize("taper", [0.0, 0.37, TAPER])
def test_the_response_is_that_of_a_quadrature(taper):
    """At frequencies along the axis from a slow to a quick phase, to ten digits of the greatest."""
    camera = CAMERA._replace(taper=taper)
    along, q = np.array([3e-5, 0.02, 0.31]), np.array([[-3.0, 5.0], [41.0, 77.0], [-900.0, 1300.0]])
    nodes, weights = np.polynomial.legendre.leggauss(400)
    start = 1 - taper
    response = 0.0
    for low, high in ((-1.0, -start), (-start, start), (start, 1.0)):
        tau, step = (low + high) / 2 + (high - low) / 2 * nodes, (high - low) / 2 * weights
        depth = (np.abs(tau) - start) / max(taper, 1e-9)
        light = np.where(np.abs(tau) <= start, 1.0, 0.5 + 0.5 * np.cos(np.pi * depth))
        t = tau * HALF
        phase = camera.acceleration * along[:, None, None] * t**2 - q[..., None] * t
        response = response + np.exp(-2j * np.pi * phase) @ (light * step * HALF)
    assert cross_motion.transfer(camera, along, q) == pytest.approx(response, abs=1e-12)


def test_without_motion_across_it_is_the_model_of_one_axis():
    """On rows, by one filter for nine speeds that are aligned at the vertex."""
    speeds = np.linspace(-4500.0, 4500.0, 9)
    scene = Scene(speeds, photon_rate=cross_motion.PHOTON_RATE, read_noise=cross_motion.READ_NOISE)
    motion = ParabolicMotion(acceleration=CAMERA.acceleration, half_exposure=HALF)
    metrics = evaluate(scene, motion, TukeyShutter(TAPER))
    f = (np.arange(1024) + 0.5) / 2048
    rows = cross_motion.normalised(f, 0 * f, 1 / (f**2 + 0.01**2), np.full(1024, 1 / 1024))
    velocities = np.stack([speeds, 0 * speeds, np.full(9, 1 / 9)], axis=1)
    level = cross_motion.psnr(CAMERA, velocities, rows)
    assert level == pytest.approx(float(metrics.expected_psnr), abs=1e-3)
    assert level != pytest.approx(float(metrics.known_speed_psnr), abs=0.1)


def test_motion_across_costs_a_snapshot_less_than_a_parabola():
    """A fifth across: hundredths of a dB of a short exposure, most of the gain of a parabola."""
    plane = cross_motion.plane(12, 3, 5)
    snapshot = cross_motion.Camera(0.0, 8.4e-4, 0.0)
    none, some = (cross_motion.ellipse(share, 7, 20) for share in (0.0, 0.2))
    lost, lost_by_parabola = (
        cross_motion.psnr(camera, none, plane) - cross_motion.psnr(camera, some, plane)
        for camera in (snapshot, CAMERA)
    )
    assert 0.02 < lost < 0.1 < 0.5 < lost_by_parabola


def test_pages_say_what_the_benchmark_found():
    """The table of questions, whole, and the gains that README names."""
    root = Path(__file__).parents[2]
    stored = (root / "benchmarks" / "results" / "cross_motion.json").read_text("utf-8")
    page, readme = ((root / name).read_text("utf-8") for name in ("docs/questions.md", "README.md"))
    words = {"0 %": "none", "10 %": "a tenth", "20 %": "a fifth", "30 %": "three tenths"}
    for row in json.loads(stored)["rows"]:
        gains = row["designed for none"], row["designed for it"]
        cells = (
            words[row["across"]],
            *(f"{gain} dB" for gain in gains),
            f"{row['exposure ms']} ms",
        )
        assert f"| {' | '.join(cells)} |" in page
        assert gains[1].lstrip("+") in readme.partition("## Five minutes")[0]
