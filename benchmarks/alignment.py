"""Where should one filter for all speeds place objects that the sensor does not keep up with?

Expected PSNR of parabolas on six scenes by several places for each speed, in dB, by sums over the
exposure that share no code with the package. `python -m benchmarks.alignment`.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402
from benchmarks.scenes import scenes  # noqa: E402
from mishutter.model.optics import frequency_grid, pixel_response  # noqa: E402
from mishutter.model.scene import picture_power  # noqa: E402

_FREQUENCIES, _INSTANTS, _STEPS = 400, 600, 40
_TAPERS = (0.0, 0.25, 0.5, 0.75, 1.0)
_SAGS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.0, 9.0, 12.0, 18.0, 25.0, 35.0)
_SHARES = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0, 1.2, 2.0)
"""Top speeds of the sensor, over that of the fastest object."""
_LONGEST = 500.0
"""Longest way of an object, beyond which so few frequencies repeat it; px."""
RULES = {
    "vertex": "the vertex, also beyond the exposure: a parabola until now",
    "lowest": "the lowest place in the exposure: a free path until now, and every path now",
    "nearer": "the place at the share $1/\\nu$ of half the exposure, where that is below 1",
    "middle": "the place at mid-exposure",
    "centroid": "the centroid of the light",
    "free": "the best place for each speed, by ascent from the place called nearer",
}


class Case(NamedTuple):
    """Numbers of a scene: speeds relative to the sensor, weights, light and the picture's power."""

    speeds: np.ndarray
    weights: np.ndarray
    rate: float
    noise: float
    mean: float
    power: np.ndarray
    aperture: np.ndarray
    frequency: np.ndarray

    @staticmethod
    def of(scene: ms.Scene) -> "Case":
        """The numbers of a scene, each speed once, in the frame of the middle of its speeds."""
        speeds, weights = np.asarray(scene.speeds, float), np.asarray(scene.weights, float)
        sizes = np.abs(speeds - (speeds.max() + speeds.min()) / 2).round(6)
        each, index = np.unique(sizes, return_inverse=True)
        dtype = np.dtype(float)
        frequency = np.asarray(frequency_grid(_FREQUENCIES, dtype))
        return Case(
            each,
            np.bincount(index, weights),
            float(scene.photon_rate),
            float(scene.read_noise),
            float(scene.picture.mean_level),
            np.asarray(picture_power(scene, _FREQUENCIES, dtype)),
            np.asarray(pixel_response(frequency, scene.optics.lens_blur)) ** 2,
            frequency,
        )

    def levels(self, half: float, sag: float, taper: float) -> dict[str, float]:
        """Expected PSNR by every rule, of a Tukey shutter; dB."""
        tau = (np.arange(_INSTANTS) + 0.5) * (2 / _INSTANTS) - 1
        open_share = np.clip((1 - np.abs(tau)) / taper, 0, 1) if taper else np.ones(_INSTANTS)
        light = np.sin(np.pi / 2 * open_share) ** 2 / _INSTANTS
        smear = self.speeds * half
        place = sag * tau**2 - smear[:, None] * tau
        waves = np.stack([np.exp(-2j * np.pi * np.outer(self.frequency, x)) @ light for x in place])
        with np.errstate(divide="ignore", invalid="ignore"):
            nu = np.where(smear > 0, smear / (2 * sag), 0.0)
        times = {
            "vertex": nu,
            "lowest": np.minimum(nu, 1),
            "nearer": np.where(nu <= 1, nu, 1 / np.maximum(nu, 1)),
            "middle": np.zeros_like(nu),
        }
        if sag == 0:
            times = dict.fromkeys(times, np.zeros_like(nu))
        shifts = {name: (sag * x - smear) * x for name, x in times.items()}
        shifts["centroid"] = place @ light / light.sum()
        shifts["free"] = self._climbed(waves, shifts["nearer"], half, light.sum())
        return {name: self._psnr(waves, x, half, light.sum()) for name, x in shifts.items()}

    def _noise(self, half: float, efficiency: float) -> float:
        electrons = self.rate * 2 * half
        return efficiency * self.mean / electrons + (self.noise / electrons) ** 2

    def _psnr(self, waves: np.ndarray, shift: np.ndarray, half: float, light: float) -> float:
        mean = self.weights @ (waves * np.exp(2j * np.pi * np.outer(shift, self.frequency)))
        every = self.weights @ np.abs(waves) ** 2 * self.aperture
        noise, coherent = self._noise(half, light), np.abs(mean) ** 2 * self.aperture
        lost = (self.power * (every - coherent) + noise) / (self.power * every + noise)
        return float(-10 * np.log10(np.mean(self.power * lost)))

    def _climbed(
        self, waves: np.ndarray, shift: np.ndarray, half: float, light: float
    ) -> np.ndarray:
        """Places of least error next to some, by Newton's steps on the overlap with the mean."""
        omega = 2 * np.pi * self.frequency
        every = self.weights @ np.abs(waves) ** 2 * self.aperture
        weight = self.power**2 * self.aperture / (self.power * every + self._noise(half, light))
        for _ in range(_STEPS):
            each = waves * np.exp(1j * np.outer(shift, omega))
            overlap = weight * np.conj(self.weights @ each) * each
            bound = (omega**2 * np.abs(overlap)).sum(axis=1)
            curvature = np.maximum((omega**2 * overlap.real).sum(axis=1), bound / 4)
            shift = shift - (omega * overlap.imag).sum(axis=1) / np.maximum(curvature, 1e-300)
        return shift


def cameras(scene: ms.Scene) -> Iterator[dict]:
    """Levels of parabolas of some exposures, tapers and sags."""
    case, limits = Case.of(scene), scene.limits
    longest = 0.8 * float(limits.max_half_exposure)
    shortest = max(float(limits.min_half_exposure), longest / 32)
    for half in np.geomspace(shortest, longest, 9):
        for taper in _TAPERS:
            for sag in _SAGS:
                if 2 * (sag + case.speeds.max() * half) <= _LONGEST:
                    top = 2 * sag / half / case.speeds.max()
                    numbers = {"half": half, "taper": taper, "sag": sag, "top": top}
                    yield numbers | case.levels(half, sag, taper)


def best(rows: list[dict], limit: str, most: float) -> dict[str, float]:
    """The level of the best camera within a limit, by every rule; dB."""
    within = [row for row in rows if row[limit] <= most * (1 + 1e-9)]
    return {rule: max(row[rule] for row in within) for rule in RULES}


def main() -> None:
    """Measure, store and print."""
    report({name.partition(":")[0]: list(cameras(scene)) for name, scene in scenes().items()})


def report(cameras_of_scenes: dict[str, list[dict]]) -> None:
    """Ranges of what other rules gain over the lowest place, stored and printed."""
    limits = [("sag", x) for x in _SAGS[1:]] + [("top", x) for x in _SHARES]
    chosen, given = [], []
    for name, rows in cameras_of_scenes.items():
        of_limits = [best(rows, *limit) for limit in limits]
        chosen.append({"scene": name} | _gains(of_limits))
        given.append({"scene": name} | _gains([row for row in rows if 0 < row["top"] < 1]))
    names = [rule for rule in RULES if rule != "lowest"]
    words = "\n".join(f"- *{rule}*: {text}" for rule, text in RULES.items())
    note = (
        "Levels by other places, less those by the lowest, dB, from the least to the greatest. Of "
        "the best camera within a limit on the sag, of 0.5 to 35 px, or on the top speed, of 0.1 "
        "to 2 times that of the fastest object; a camera at rest is among them:"
    )
    more = "Of every camera that is slower than the fastest object, 9 exposures and 5 tapers each:"
    harness.write("alignment", chosen, slower=given)
    tables = [harness.table(each, ["scene", *names]) for each in (chosen, given)]
    text = (
        f"## Where objects are placed\n\n{words}\n\n{note}\n\n{tables[0]}\n\n{more}\n\n{tables[1]}"
    )
    harness.section("alignment", text)


def _gains(levels: list[dict]) -> dict[str, str]:
    """Range of each rule's levels less those by the lowest place; dB."""
    gains = {rule: [each[rule] - each["lowest"] for each in levels] for rule in RULES}
    return {rule: f"{min(all_) + 0:.2f} to {max(all_) + 0:.2f}" for rule, all_ in gains.items()}


if __name__ == "__main__":
    main()
