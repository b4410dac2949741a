r"""What does motion across the axis cost a camera whose sensor accelerates along it?

Velocities are uniform in an ellipse whose longer axis is that of the sensor, and one
filter over the plane restores all of them. At the frequency $\mathbf f$ the response to an object
of velocity $\mathbf v$ is that of one axis, for a parabola of acceleration $a f_x$ and an object at
$q = \mathbf f\cdot\mathbf v$: $\int w\,e^{-2\pi i(a f_x t^2 - q t)}\,dt$. For an open shutter and
its cosine tapers it is a sum of Fresnel integrals. The picture's power falls as
$(f_x^2 + f_y^2 + 0.01^2)^{-3/2}$, whose rows have the spectrum that the package takes by default.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import fresnel

from benchmarks import harness

MEAN, DEVIATION, KNEE = 0.25, 0.2, 0.01
"""Of the picture: white = 1, and cycles/px."""
SPEED, PHOTON_RATE, READ_NOISE, MAX_STROKE = 4500.0, 1e5, 8.0, 45.0
"""Of the built-in scene: px/s along the axis, e-/s, e- and px."""
SHARES = (0.0, 0.1, 0.2, 0.3)
"""Greatest speed across the axis over that along it."""


class Plane(NamedTuple):
    """Frequencies, the picture's power there, and what each adds to its variance; all flat."""

    along: np.ndarray
    across: np.ndarray
    power: np.ndarray
    weights: np.ndarray


class Camera(NamedTuple):
    """A parabola and a Tukey shutter; without an acceleration, an open snapshot. In px and s."""

    acceleration: float
    half_exposure: float
    taper: float


def legendre(count: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights of an interval."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return low + (high - low) * (nodes + 1) / 2, weights * (high - low) / 2


def plane(radii: int = 28, corner: int = 6, angles: int = 8) -> Plane:
    """Polar nodes of one quadrant of the square; the others are alike."""
    root, weights = legendre(radii, 0, 1)
    far, far_weights = legendre(corner, 0.5, np.sqrt(0.5))
    radius = np.concatenate([root**2 / 2, far])  # dense at low frequencies
    widths = np.concatenate([root * weights, far_weights]) * radius
    nodes = []
    for r, width in zip(radius, widths, strict=True):
        low = 0.0 if r <= 0.5 else np.arccos(0.5 / r)
        angle, steps = legendre(angles, low, np.pi / 2 - low)
        nodes.append(np.stack([r * np.cos(angle), r * np.sin(angle), width * steps]))
    along, across, area = np.concatenate(nodes, axis=1)
    return normalised(along, across, (along**2 + across**2 + KNEE**2) ** -1.5, 4 * area)


def normalised(along: np.ndarray, across: np.ndarray, power: np.ndarray, area: np.ndarray) -> Plane:
    """The plane on which the picture has its variance."""
    power = power * DEVIATION**2 / (power * area).sum()
    return Plane(along, across, power, power * area)


def ellipse(share: float, radii: int = 9, angles: int = 24) -> np.ndarray:
    """Velocities uniform in an ellipse, px/s, beside the weight of each; shape `(n, 3)`."""
    square, weights = legendre(radii, 0, 1)
    angle = 2 * np.pi * (np.arange(angles) + 0.5) / angles
    radius, angle = np.meshgrid(SPEED * np.sqrt(square), angle, indexing="ij")
    parts = (radius * np.cos(angle), share * radius * np.sin(angle))
    return np.stack([*map(np.ravel, parts), np.repeat(weights / angles, angles)], axis=1)


def transfer(camera: Camera, along: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Response to objects that pass a frequency `q` times a second; s, in the shape of `q`."""
    half, taper = camera.half_exposure, camera.taper
    if camera.acceleration == 0:
        return 2 * half * np.sinc(2 * half * q) + 0j
    start = (1 - taper) * half
    total = piece(camera, along, q, -start, start)
    if taper > 0:
        shift = 1 / (2 * taper * half)
        turn = np.exp(2j * np.pi * shift * start)
        for low, high in ((start, half), (-half, -start)):
            total = total + piece(camera, along, q, low, high) / 2
            for way in (1, -1):
                phase = turn ** (-way * np.sign(low + high))
                total = total + phase * piece(camera, along, q + way * shift, low, high) / 4
    return total


def piece(camera: Camera, along: np.ndarray, q: np.ndarray, low: float, high: float) -> np.ndarray:
    """The integral of an open piece by the Fresnel integrals at its ends."""
    rate = camera.acceleration * along[:, None]
    middle, scale = q / (2 * rate), 2 * np.sqrt(rate)
    (s1, c1), (s0, c0) = (fresnel(scale * (end - middle)) for end in (high, low))
    return np.exp(2j * np.pi * rate * middle**2) * ((c1 - c0) - 1j * (s1 - s0)) / scale


def psnr(camera: Camera, velocities: np.ndarray, frequencies: Plane) -> float:
    """Expected PSNR of one filter for all velocities, from the lowest place of each; dB."""
    along, across, power, weights = frequencies
    v, w, share = velocities.T
    response = transfer(camera, along, np.outer(along, v) + np.outer(across, w))
    if camera.acceleration > 0:
        turn = np.clip(v / (2 * camera.acceleration), -camera.half_exposure, camera.half_exposure)
        place = (camera.acceleration * turn - v) * turn
        response = response * np.exp(2j * np.pi * np.outer(along, place))
    light = PHOTON_RATE * np.sqrt(power) * np.sinc(along) * np.sinc(across)
    throughput = 2 * camera.half_exposure * (1 - camera.taper / 2)
    noise = MEAN * PHOTON_RATE * throughput + READ_NOISE**2
    mean = np.abs(light * (response @ share)) ** 2
    square = light**2 * (np.abs(response) ** 2 @ share) + noise
    return float(-10 * np.log10((weights * (1 - mean / square)).sum()))


def best_snapshot(share: float, frequencies: Plane) -> Camera:
    """The open exposure at rest of the greatest level."""
    velocities = ellipse(share)

    def loss(x: np.ndarray) -> float:
        return -psnr(Camera(0.0, np.exp(x[0]), 0.0), velocities, frequencies)

    found = minimize(loss, [np.log(6e-4)], method="Nelder-Mead", options={"xatol": 1e-3})
    return Camera(0.0, float(np.exp(found.x[0])), 0.0)


def best_parabola(share: float, frequencies: Plane) -> Camera:
    """The best stroke, exposure and taper from three starts."""
    velocities = ellipse(share)

    def camera(x: np.ndarray) -> Camera:
        half, stroke = np.exp(x[0]), MAX_STROKE * min(np.exp(x[1]), 1.0)
        return Camera(stroke / half**2, float(half), float(np.clip(x[2], 1e-3, 1.0)))

    def loss(x: np.ndarray) -> float:
        return -psnr(camera(x), velocities, frequencies)

    starts = [(6e-3, 0.9, 0.9), (9e-3, 0.9, 0.6), (4e-3, 0.4, 0.8)]
    options = {"xatol": 1e-3, "fatol": 1e-5, "maxfev": 200}
    runs = [
        minimize(loss, [np.log(h), np.log(s), t], method="Nelder-Mead", options=options)
        for h, s, t in starts
    ]
    return camera(min(runs, key=lambda run: run.fun).x)


def main() -> None:
    """Measure, store and print."""
    frequencies = plane()
    kept = best_parabola(0.0, frequencies)
    rows = []
    for share in SHARES:
        velocities = ellipse(share)
        snapshot = best_snapshot(share, frequencies)
        again = kept if share == 0 else best_parabola(share, frequencies)
        level = psnr(snapshot, velocities, frequencies)
        rows.append(
            {
                "across": f"{100 * share:.0f} %",
                "best snapshot": f"{level:.2f}",
                "its exposure ms": f"{2e3 * snapshot.half_exposure:.2f}",
                "designed for none": f"{psnr(kept, velocities, frequencies) - level:+.2f}",
                "designed for it": f"{psnr(again, velocities, frequencies) - level:+.2f}",
                "stroke px": f"{again.acceleration * again.half_exposure**2:.1f}",
                "exposure ms": f"{2e3 * again.half_exposure:.1f}",
                "taper": f"{again.taper:.2f}",
            }
        )
        print(rows[-1], flush=True)
    harness.write("cross_motion", rows)
    note = (
        f"Up to {SPEED:,.0f} px/s along the axis and a share of it across, uniform in an ellipse; "
        f"{PHOTON_RATE:.0e} e-/s and {READ_NOISE:.0f} e-, as in the built-in scene. Gains over the "
        "best snapshot of a parabola behind a Tukey shutter, dB, by one filter over the plane: of "
        "the camera designed for no motion across, and of one designed for it."
    )
    text = harness.table(rows, list(rows[0]))
    harness.section("cross_motion", f"## Motion across the axis\n\n{text}\n\n{note}")


if __name__ == "__main__":
    main()
