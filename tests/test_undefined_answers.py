"""No public function makes a number of NaN.

Each is asked, under `jax.jit` and `jax.vmap` or where its numbers are known, for NaN in every
argument: whatever depends on it is NaN, or an error names it. A branch that a comparison with NaN
chooses would be a level, and the best of all. A function that is new stands in the table, or the
first test fails.
"""

import re
from collections.abc import Callable
from inspect import isclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.bursts import FRAMES, a_burst_design
from support.cases import DEVICES, MOTIONS, SHUTTERS
from support.plane import frames_of, scene_of

import mishutter as ms

LIMITS = ms.Limits(max_stroke=16.3, max_top_speed=4300.0, max_half_exposure=0.021, max_pan=310.0)
SCENE = ms.Scene(
    [-1200.0, 130.0, 700.0],
    weights=[0.3, 0.5, 0.2],
    photon_rate=1.1e5,
    read_noise=5.3,
    optics=ms.Optics(lens_blur=0.4),
    limits=LIMITS,
    burst=ms.BurstMode(frames_per_s=90.0, max_frames=2),
)
MOTION = ms.ParabolicMotion(acceleration=4.1e4, half_exposure=0.0123, velocity=57.0)
SHUTTER = ms.SplineShutter([0.3, 0.9, 0.8, 0.95, 0.4, 0.2])
DESIGN = SCENE, MOTION, SHUTTER
LIGHT = np.random.default_rng(5).random((2, 96))
TRACE = np.array([[-0.02, 0.0], [-0.01, 0.1], [0.0, 0.9], [0.01, 0.8], [0.02, 0.0]])

NAMED = r"^`[^`]+` must .*; got "
"""An error with a name."""
NO_NUMBER = "It takes no number."
OF_FILES = "Numbers of files are checked where they are read."
OF_DESIGN = "Numbers of a design are known, and checked where it is made."
OF_MAP = "NaN in a map is a point that was not computed."
OF_TARGETS = "Pictures of targets are checked where they are read."


class Asked(NamedTuple):
    """A function, and arguments at which it has an answer; each may be a tree of numbers."""

    answer: Callable
    traced: tuple = ()  # Arguments that it takes where JAX traces them
    known: tuple = ()  # Arguments after these, which it takes only where they are known


def _named(function, *names, **others):
    """The function by the names of its arguments."""
    return lambda *values: function(**dict(zip(names, values, strict=True)), **others)


def _of_numbers(method, **others):
    parameters = ms.DesignParameters(*DESIGN, **others)
    answer = parameters.loss() if method == "loss" else getattr(parameters, method)
    return Asked(answer, (np.array(parameters.start),))


def _of_frames():
    limits = ms.Limits(max_stroke=30, max_acceleration=1e6, max_half_exposure=0.02)
    burst = ms.BurstMode(frames_per_s=40, window=0.09)
    scene = ms.Scene([0.0, 700.0], photon_rate=3e4, read_noise=5.0, limits=limits, burst=burst)
    frames = [ms.TimedFrame(ms.LinearMotion(half_exposure=0.005, velocity=300.0), -0.03)]
    frames += [ms.TimedFrame(ms.LinearMotion(half_exposure=0.004, velocity=-200.0), 0.01)]
    parameters = ms.ExposureParameters(scene, frames)
    return Asked(parameters.frames, (np.array(parameters.start),))


def _of_motion(motion, time, speed):
    """Numbers of a motion that depend on all of it."""
    places = motion.position(time), motion.velocity_at(time), motion.alignment(speed)
    return *places, motion.stroke, motion.top_speed, motion.exposure, motion.kernel_length(speed)


def is_number(leaf):
    """Whether a leaf of a tree is a floating number, or an array of some."""
    is_array = isinstance(leaf, float | np.ndarray | jax.Array)
    return is_array and jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)


def numbers_of(arguments):
    """Names and values of the numbers of a tree, and a function that makes it of others."""
    leaves, structure = jax.tree_util.tree_flatten_with_path(arguments)
    places = [index for index, (_, leaf) in enumerate(leaves) if is_number(leaf)]

    def made_of(numbers):
        filled = [leaf for _, leaf in leaves]
        for place, number in zip(places, numbers, strict=True):
            kind = type(filled[place])
            if not isinstance(number, jax.core.Tracer):
                number = kind(number) if kind is float else number
                number = jnp.asarray(number) if issubclass(kind, jax.Array) else number
            filled[place] = number
        return jax.tree.unflatten(structure, filled)

    names = [jax.tree_util.keystr(leaves[place][0]) for place in places]
    return names, [np.array(leaves[place][1], np.float64) for place in places], made_of


def _changed(numbers, index, change):
    row = [number.copy() for number in numbers]
    row[index].reshape(-1)[-1] = change(row[index].reshape(-1)[-1])
    return row


def moved(numbers, index):
    """The numbers, the last entry of one of which is another."""
    return _changed(numbers, index, lambda number: 1.01 * number + 1e-3 * (number == 0))


def undefined(numbers, index):
    """The numbers, the last entry of one of which is none."""
    return _changed(numbers, index, lambda number: number * np.nan)


def floats_of(answer):
    """The floating numbers of an answer."""
    is_tree = isinstance(answer, eqx.Module | tuple | list | dict | np.ndarray | jax.Array | float)
    leaves = jax.tree.leaves(answer if is_tree else vars(answer) if answer is not None else ())
    return [leaf for leaf in leaves if is_number(leaf)]


def hides(good, other, holed):
    """Whether an answer has a number where it depends on one that is none.

    What changes with the number depends on it, and is NaN; the rest may be so, or is as it was.
    """
    return any(
        a.shape != c.shape or np.any(~np.isnan(c) & ((a != b) | (a != c)))
        for a, b, c in zip(good, other, holed, strict=True)
    )


FUNCTIONS = {
    "LinearMotion": lambda: Asked(
        _named(ms.LinearMotion, "half_exposure", "velocity"), (0.013, 57.0)
    ),
    "StillCamera": lambda: Asked(_named(ms.StillCamera, "half_exposure"), (0.013,)),
    "best_in_plane": lambda: Asked(ms.best_in_plane, (), (scene_of("A"),)),
    "best_sequence": lambda: Asked(ms.best_sequence, (), (SCENE,)),
    "binned_exposure": lambda: Asked(
        _named(ms.binned_exposure, "shutter", "motion", "speed", "edges"),
        (SHUTTER, MOTION, 310.0, np.array([-7.3, -1.9, 2.3, 8.1])),
    ),
    "blur_kernel": lambda: Asked(
        _named(ms.blur_kernel, "shutter", "motion", "speed", "phase", num_taps=9),
        (SHUTTER, MOTION, 310.0, -0.37),
    ),
    "capture_and_restore": lambda: Asked(
        _named(ms.capture_and_restore, "subject", "scene", "motion", "shutter", "speed"),
        (),
        (LIGHT, *DESIGN, 310.0),
    ),
    "ceiling": lambda: Asked(_named(ms.ceiling, "scene", "max_half_exposure"), (), (SCENE, 0.0157)),
    "centred_kernel": lambda: Asked(
        _named(ms.centred_kernel, "motion", "shutter", "speed", "lens_blur"),
        (),
        (MOTION, SHUTTER, 310.0, 0.4),
    ),
    "compare": lambda: Asked(ms.compare, (), DESIGN),
    "condition_number": lambda: Asked(ms.condition_number, (np.array([0.1, 0.5, 0.3]),)),
    "deconvolve": lambda: Asked(ms.deconvolve, (LIGHT,), DESIGN),
    "estimate_speed": lambda: Asked(ms.estimate_speed, (), (LIGHT, *DESIGN)),
    "evaluate": lambda: Asked(ms.evaluate, DESIGN),
    "measure": lambda: Asked(
        _named(ms.measure, "clip", "frames_per_s"),
        (),
        (np.random.default_rng(1).normal(100, 10, (8, 64, 64)), 25.0),
    ),
    "measured_profile": lambda: Asked(
        _named(ms.measured_profile, "trace", "half_exposure", "middle"),
        (),
        (TRACE, 0.015, 0.001),
    ),
    "optimise": lambda: Asked(_named(ms.optimise, "scene", "motion", "shutter"), (), DESIGN),
    "exposures_psnr": lambda: Asked(
        lambda plane, along: (
            ms.exposures_psnr(scene_of("A"), plane, num_panels=2),
            ms.exposures_psnr(SCENE, along, num_panels=8),
        ),
        (frames_of("A", 2, "still"),),
        (FRAMES,),
    ),
    "psnr": lambda: Asked(ms.psnr, (), (LIGHT, LIGHT**1.1)),
    "read_noise_from_dynamic_range": lambda: Asked(
        _named(ms.read_noise_from_dynamic_range, "dynamic_range", "full_well"), (), (70.0, 1e4)
    ),
    "restore": lambda: Asked(
        lambda light, speed: ms.restore(light, a_burst_design(), speed=speed),
        (),
        (np.stack([LIGHT] * 2), 310.0),
    ),
    "restore_frames": lambda: Asked(
        lambda light, scene, speed: ms.restore_frames(light, scene, FRAMES, speed=speed),
        (),
        (np.stack([LIGHT] * 2), SCENE, 310.0),
    ),
    "restore_photograph": lambda: Asked(ms.restore_photograph, (), (LIGHT, *DESIGN)),
    "richardson_lucy": lambda: Asked(
        _named(ms.richardson_lucy, "captured", "kernel", num_iterations=3),
        (LIGHT,),
        (np.array([0.2, 0.5, 0.3]),),
    ),
    "simulate_capture": lambda: Asked(
        _named(
            ms.simulate_capture, "picture", "scene", "motion", "shutter", "speed", "displacement"
        ),
        (LIGHT,),
        (*DESIGN, 310.0, 1.3),
    ),
    "simulate_frames": lambda: Asked(
        lambda light, scene, speed: ms.simulate_frames(light, scene, FRAMES, speed=speed),
        (),
        (LIGHT, SCENE, 310.0),
    ),
    "stage_path": lambda: Asked(
        _named(ms.stage_path, "motion", "max_acceleration"), (), (MOTION, 4e5)
    ),
    "starting_shutter": lambda: Asked(ms.starting_shutter, (), (SCENE,)),
    "sweep": lambda: Asked(
        _named(ms.sweep, "scenes", "accelerations", "half_exposures"),
        (),
        (SCENE, np.array([3e4, 4e4]), np.array([0.0123])),
    ),
    "tolerance_costs": lambda: Asked(ms.tolerance_costs, (), DESIGN),
    "transfer_function": lambda: Asked(
        _named(ms.transfer_function, "shutter", "motion", "speed", "frequency"),
        (SHUTTER, MOTION, 310.0, np.array([0.03, 0.31])),
    ),
    "with_recorded_path": lambda: Asked(
        lambda path, middle: ms.with_recorded_path(a_burst_design(), path, middle=middle),
        (),
        (ms.RecordedPath(np.linspace(-0.03, 0.03, 61), np.zeros((1, 61))), 0.0),
    ),
}
"""What each public function is asked."""
NOT_ASKED = {
    NO_NUMBER: "baselines example_picture example_scene keep_compiled_programs register_shutter",
    OF_FILES: "design_from_drive read_drive read_frames read_layers read_measurements read_path "
    "read_picture read_scene read_trace row_power_spectrum write_layers write_picture",
    OF_DESIGN: "drive_table frame_table plot_design",
    OF_MAP: "best_points gain_over gain_over_snapshot light_map pareto_front plot_front plot_map",
    OF_TARGETS: "fit",
}
"""Why others are not."""
METHODS = (
    {
        name: lambda name=name: Asked(getattr(ms, name)(), DESIGN)
        for name in dir(ms)
        if name.endswith("Loss") and not name.startswith("Abstract")
    }
    | {
        "a sum of losses": lambda: Asked(ms.ExpectedErrorLoss() + 0.3 * ms.DesignLoss(), DESIGN),
        "DesignParameters.loss": lambda: _of_numbers("loss"),
        "DesignParameters.loss of a profile": lambda: _of_numbers("loss", free="shutter"),
        "DesignParameters.design": lambda: _of_numbers("design"),
        "ExposureParameters.frames": _of_frames,
        "DesignParameters.numbers": lambda: Asked(
            lambda *design: ms.DesignParameters(*DESIGN).numbers(*design), (MOTION, SHUTTER)
        ),
    }
    | {
        f"shutter {slug}": lambda slug=slug: Asked(
            lambda shutter, tau: (shutter.transmittance(tau), shutter.efficiency()),
            (SHUTTERS[slug].shutter(), np.array([-0.83, 0.31])),
        )
        for slug in SHUTTERS
    }
    | {
        f"motion {slug}": lambda slug=slug: Asked(
            _of_motion, (MOTIONS[slug](), np.array([-2e-3, 7e-3]), 310.0)
        )
        for slug in MOTIONS
    }
    | {
        f"device {slug}": lambda slug=slug: Asked(
            lambda device, shutter, half: device.light(shutter, half, SHUTTER.dtype()).efficiency(),
            (DEVICES[slug](), SHUTTER, 0.0123),
        )
        for slug in DEVICES
    }
)
"""What losses, shutters, motions, devices and designs by numbers are asked."""
SLOW = {
    "DesignParameters.loss",
    "FoundSpeedLoss",
    "WorstSpeedLoss",
    "a sum of losses",
    "device first-order-late",
    "device first-order-of-levels",
    "evaluate",
    "measure",
}


def test_every_public_function_is_asked():
    """One that is added to the package has to stand in a table, and one that left it may not."""
    public = {each: getattr(ms, each) for each in ms._names}
    public = {each for each, value in public.items() if callable(value) and not isclass(value)}
    not_asked = [each for names in NOT_ASKED.values() for each in names.split()]
    assert sorted(public) == sorted([*FUNCTIONS, *not_asked])


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(each, marks=pytest.mark.slow) if each in SLOW else each
        for each in FUNCTIONS | METHODS
    ],
)
def test_nan_is_never_a_number(name):
    """Of any number of any argument, under `jit` and `vmap` or where it is known."""
    asked = (FUNCTIONS | METHODS)[name]()
    assert asked.traced or asked.known
    assert hidden_by_tracing(asked) + hidden_where_known(asked) == []


def hidden_by_tracing(asked):
    """Names of numbers whose NaN an answer hides, asked together in one compiled program."""
    names, numbers, made_of = numbers_of(asked.traced)
    changes = [change(numbers, i) for i in range(len(numbers)) for change in (moved, undefined)]
    if not names:
        return []
    columns = [jnp.asarray(np.stack(each)) for each in zip(numbers, *changes, strict=True)]
    of_row = jax.vmap(lambda row: floats_of(asked.answer(*made_of(row), *asked.known)))
    answers = [np.asarray(answer) for answer in jax.jit(of_row)(columns)]
    assert answers
    assert not any(np.any(np.isnan(answer[0])) for answer in answers)
    rows = [[answer[index] for answer in answers] for index in range(len(changes) + 1)]
    trios = zip(names, rows[1::2], rows[2::2], strict=True)
    return [name for name, other, holed in trios if hides(rows[0], other, holed)]


def hidden_where_known(asked):
    """Names of known numbers whose NaN is neither refused by a name nor seen in the answer."""
    names, numbers, made_of = numbers_of(asked.known)

    def answers(numbers):
        return [np.asarray(x) for x in floats_of(asked.answer(*asked.traced, *made_of(numbers)))]

    hidden = []
    for index, name in enumerate(names):
        try:
            holed = answers(undefined(numbers, index))
        except ValueError as error:
            if not re.match(NAMED, str(error)):
                hidden.append(f"{name}: {error}")
            continue
        if hides(answers(numbers), answers(moved(numbers, index)), holed):
            hidden.append(name)
    return hidden
