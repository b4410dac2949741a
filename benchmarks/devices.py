"""What is a design worth that knows its shutter device, beside one that is sent to it blindly?

Each expected PSNR is computed again by a simulation of its own, in NumPy and SciPy alone: the
command's means over slots, the device's differential equation by Runge-Kutta steps in time, the
transfer functions by sums over time, and the expected error of the best single linear filter.
"""

import time

import numpy as np

from benchmarks import harness
from benchmarks.scenes import scenes
from mishutter import (
    Design,
    FirstOrderDevice,
    IdealDevice,
    Scene,
    SwitchedDevice,
    evaluate,
    optimise,
)
from mishutter.model.devices import AbstractDevice
from mishutter.model.motion import AbstractMotion, steady
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.chips import ChippedShutter
from mishutter.search.search import with_device

BANDWIDTHS = (30, 100, 1000)
"""Hz, at which a first-order device passes half the power: 10 to 90 % takes 0.35 over it."""
LEVELS, SLOTS = (2, 3, 4, 8, 16), (64, 128, 256)
_STEPS_A_SLOT, _NUM_FREQUENCIES = 64, 1024
NOTE = (
    "A device of a bandwidth f takes 0.35/f from 10 to 90 %, up and down alike, and holds its "
    "command over 64 slots. *Blind*: the best design for a device that follows everything, sent "
    "as it is. *Through*: what `optimise` finds for the device. *Check*: the larger difference of "
    "both from a simulation that shares no code with the package."
)


def device(bandwidth: float) -> FirstOrderDevice:
    """A first-order device of a bandwidth in Hz."""
    return FirstOrderDevice(rise_time=0.35 / bandwidth, fall_time=0.35 / bandwidth)


def simulated_psnr(
    scene: Scene, motion: AbstractMotion, command: AbstractShutter, made: FirstOrderDevice
) -> float:
    """Expected PSNR of a command through a first-order device, by small steps in time; dB."""
    half = float(motion.half_exposure)
    levels = _slot_means(command, made.num_slots or 0)
    rise, fall = (float(x) / np.log(9.0) for x in (made.rise_time, made.fall_time))
    state, step = levels[0], 2 * half / (levels.size * _STEPS_A_SLOT)
    states = [state]
    for level in np.repeat(levels, _STEPS_A_SLOT):
        theta = rise if level > state else fall

        def slope(x: float, level: float = level, theta: float = theta) -> float:
            return (level - x) / theta

        first = slope(state)
        second = slope(state + step / 2 * first)
        third = slope(state + step / 2 * second)
        fourth = slope(state + step * third)
        state += step / 6 * (first + 2 * second + 2 * third + fourth)
        states.append(state)
    weights = np.full(len(states), 1.0)
    weights[[0, -1]] = 0.5
    weights /= weights.sum()
    opened = float(made.leakage) + (1 - float(made.leakage)) * np.array(states)
    light = weights * float(made.transmission) * opened
    return _expected_psnr(scene, motion, np.linspace(-half, half, len(states)), light)


def _slot_means(command: AbstractShutter, count: int) -> np.ndarray:
    """Mean of a spline over equal slots, by SciPy's antiderivative; or the chips themselves."""
    from scipy.interpolate import BSpline

    if isinstance(command, ChippedShutter):
        return np.asarray(command.transmittances)
    weights = np.asarray(command.coefficients)  # type: ignore[attr-defined]  # type: ignore[attr-defined]
    knots = np.concatenate([[-1.0] * 3, np.linspace(-1, 1, weights.size - 2), [1.0] * 3])
    whole = BSpline(knots, weights, 3).antiderivative()
    return np.diff(whole(np.linspace(-1, 1, count + 1))) * count / 2


def _expected_psnr(
    scene: Scene, motion: AbstractMotion, times: np.ndarray, light: np.ndarray
) -> float:
    """Expected PSNR of light at some times, section 2 of the package's physics; dB."""
    a, v = float(steady(motion).acceleration), float(motion.velocity)
    speeds, shares = np.asarray(scene.speeds) - v, np.asarray(scene.weights)
    frequencies = (np.arange(_NUM_FREQUENCIES) + 0.5) * (0.5 / _NUM_FREQUENCIES)
    given = np.asarray(scene.picture.power_spectrum)
    power = np.repeat(given, _NUM_FREQUENCIES // given.size)
    power = power / power.mean() * float(scene.picture.deviation) ** 2
    responses = []
    for speed in speeds:
        turn = np.clip(speed / (2 * a), times[0], times[-1]) if a > 0 else 0.0
        path = a * times**2 - speed * times - (a * turn - speed) * turn
        waves = [light @ np.exp(-2j * np.pi * np.outer(path, f)) for f in np.split(frequencies, 16)]
        responses.append(np.concatenate(waves) * np.sinc(frequencies))
    responses = np.array(responses)
    mean = shares @ responses
    spread = shares @ np.abs(responses - mean) ** 2
    electrons = float(scene.photon_rate) * (times[-1] - times[0])
    noise = light.sum() * float(scene.picture.mean_level) / electrons
    noise += (float(scene.read_noise) / electrons) ** 2
    left = (power * spread + noise) / (power * (np.abs(mean) ** 2 + spread) + noise)
    return -10 * np.log10(np.mean(power * left))


def bandwidth_row(name: str, scene: Scene, ideal: Design, bandwidth: float) -> dict:
    """Blind and designed-through PSNR of a scene, and how far the simulation is from both."""
    start, made = time.perf_counter(), device(bandwidth)
    through = with_device(scene, made)
    found = optimise(through)
    pairs = ((ideal.motion, ideal.command), (found.motion, found.command))
    own = [float(evaluate(through, *pair).expected_psnr) for pair in pairs]
    checks = [simulated_psnr(scene, *pair, made) for pair in pairs]
    return {
        "scene": name,
        "bandwidth Hz": bandwidth,
        "ideal device dB": f"{float(ideal.metrics.expected_psnr):.3f}",
        "blind dB": f"{own[0]:.3f}",
        "through dB": f"{own[1]:.3f}",
        "gain dB": f"{own[1] - own[0]:+.3f}",
        "check dB": f"{max(abs(x - y) for x, y in zip(own, checks, strict=True)):.4f}",
        "s": round(time.perf_counter() - start),
    }


def rounded_row(name: str, scene: Scene, ideal: Design, made: AbstractDevice) -> dict:
    """What rounding costs on a device of few levels, blindly and searched; dB."""
    start = time.perf_counter()
    found = optimise(with_device(scene, made))
    level, best = (float(each.metrics.expected_psnr) for each in (ideal, found))
    return {
        "device": name,
        "blind dB": f"{(found.psnr_ignoring_lag or level) - level:+.4f}",
        "searched dB": f"{best - level:+.4f}",
        "s": round(time.perf_counter() - start),
    }


def main() -> None:
    """Measure, store and print."""
    import jax

    jax.config.update("jax_enable_x64", True)
    every = scenes()
    chosen = {name: scene for name, scene in every.items() if name.startswith(_SCENES)}
    street = next(scene for name, scene in every.items() if name.startswith("street"))
    chosen["street, from a sensor that may not pan"] = street.without_pan()
    ideal = {name: optimise(scene) for name, scene in chosen.items()}
    rows = []
    for name, scene in chosen.items():
        for bandwidth in BANDWIDTHS:
            rows.append(bandwidth_row(name, scene, ideal[name], bandwidth))
            print(rows[-1], flush=True)
    built_in = next(iter(chosen))
    devices = {f"{n} levels, 128 slots": IdealDevice(levels=n) for n in LEVELS}
    devices |= {f"binary, {n} slots": SwitchedDevice(num_slots=n) for n in SLOTS}
    of_levels = []
    for name, made in devices.items():
        of_levels.append(rounded_row(name, chosen[built_in], ideal[built_in], made))
        print(of_levels[-1], flush=True)
    harness.write("devices", rows, levels=of_levels)
    text = (
        f"## Shutter devices: designs that know them\n\n{harness.table(rows, list(rows[0]))}\n\n"
        f"{NOTE}\n\nThe built-in scene at few levels, against any level at any time:\n\n"
        f"{harness.table(of_levels, list(of_levels[0]))}"
    )
    harness.section("devices", text)


_SCENES = ("built-in", "slow, long")

if __name__ == "__main__":
    main()
