"""Numbers that no constructor checks: by `eqx.tree_at`, `jax.vmap` or a solver's step.

A level that a comparison with NaN chose was the best of all, and one of a mirrored path was that of
a camera at rest.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import MOTIONS, SHUTTERS

from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    FreeMotion,
    Limits,
    ParabolicMotion,
    Scene,
    SplineShutter,
    TukeyShutter,
    centred_kernel,
    evaluate,
    sweep,
)
from mishutter.evaluation.metrics import METRICS
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE
from mishutter.evaluation.views import nan_unless_defined

SCENE = Scene(
    [-1200.0, 0.0, 700.0, 1200.0],
    weights=[0.1, 0.4, 0.2, 0.3],
    photon_rate=1e5,
    read_noise=5,
    limits=Limits(max_stroke=16, max_half_exposure=0.02),
)
MOTION = ParabolicMotion(acceleration=4e4, half_exposure=0.012, velocity=50.0)
LOSSES = {
    type(loss).__name__: loss
    for row in SPEED_KNOWLEDGE.values()
    for loss in (row.loss(), row.worst_loss and row.worst_loss(), DesignLoss())
    if loss is not None
} | {"free": ExpectedErrorLoss(alignment="free")}
PROFILE = np.array([0.3, 0.9, 0.8, 0.95, 0.4, 0.2])


def holed(part, number):
    """A module with NaN for the last entry of one of its floating arrays."""
    leaves, structure = jax.tree.flatten(part)
    places = [i for i, leaf in enumerate(leaves) if eqx.is_inexact_array(leaf)]
    place = places[number]
    leaves[place] = (
        jnp.asarray(leaves[place]).ravel().at[-1].set(jnp.nan).reshape(jnp.shape(leaves[place]))
    )
    return jax.tree.unflatten(structure, leaves)


def num_numbers(part):
    return sum(map(eqx.is_inexact_array, jax.tree.leaves(part)))


@pytest.mark.parametrize("make", MOTIONS.values(), ids=MOTIONS)
def test_a_known_motion_without_a_number_is_refused_by_its_name(make):
    """By every loss, by `evaluate` and by a kernel, whichever number it is."""
    motion = make()
    for number in range(num_numbers(motion)):
        line = rf"^`{type(motion).__name__}\(\w+=...\)` must be finite; got"
        bad = holed(motion, number)
        for measure in (*LOSSES.values(), evaluate):
            with pytest.raises(ValueError, match=line):
                measure(SCENE, bad, TukeyShutter(0.37))
        with pytest.raises(ValueError, match=r"^`.*` must .*; got .*nan"):
            centred_kernel(bad, TukeyShutter(0.37))


@pytest.mark.parametrize("case", SHUTTERS.values(), ids=SHUTTERS)
def test_a_known_shutter_without_a_number_is_refused_by_its_name(case):
    """By every loss, by `evaluate`, a kernel and a sweep, whichever number it is."""
    shutter = case.shutter()
    for number in range(num_numbers(shutter)):
        line = rf"^`{type(shutter).__name__}\(\w+=...\)` must be finite; got"
        bad = holed(shutter, number)
        for measure in (*LOSSES.values(), evaluate):
            with pytest.raises(ValueError, match=line):
                measure(SCENE, MOTION, bad)
        with pytest.raises(ValueError, match=line):
            centred_kernel(MOTION, bad)
        with pytest.raises(ValueError, match=line):
            sweep(SCENE, accelerations=[4e4], half_exposures=[0.012], shutters={"bad": bad})


def test_a_path_that_runs_against_its_sign_is_refused_by_its_name():
    """Where it is known, a negative acceleration is an error, as it is where one is made."""
    bad = eqx.tree_at(lambda m: m.acceleration, MOTION, jnp.asarray(-4e4))
    line = r"^`ParabolicMotion\(acceleration=...\)` must be at least 0 px/s\^2; got -40000.0"
    with pytest.raises(ValueError, match=line):
        evaluate(SCENE, bad, TukeyShutter(0.37))


@pytest.mark.parametrize("make", MOTIONS.values(), ids=MOTIONS)
def test_every_traced_number_of_a_design_counts(make):
    """A value is NaN where one of the numbers of motion or shutter is, and as it was elsewhere."""
    value = jax.jit(lambda motion, shutter: nan_unless_defined(7.3, motion, shutter))
    motion, spline = make(), SHUTTERS["spline"].shutter()
    assert value(motion, spline) == 7.3
    for number in range(num_numbers(motion)):
        assert np.isnan(value(holed(motion, number), spline))
    for case in SHUTTERS.values():
        shutter = case.shutter()
        for number in range(num_numbers(shutter)):
            assert np.isnan(value(motion, holed(shutter, number)))
    closed = eqx.tree_at(lambda m: m.half_exposure, motion, -motion.half_exposure)
    assert np.isnan(value(closed, spline))


@pytest.mark.slow
def test_levels_of_traced_numbers():
    """Every loss and metric is NaN where a number is, and of a mirrored path the mirror's.

    Mirrored are the accelerations, the pan, and how often things move either way.
    """
    rates = np.array([1.3, 0.7, 1.9]) * 4e4

    def measured(numbers):
        a, half, pan, speeds, profile = numbers
        motion = FreeMotion(accelerations=a, half_exposure=half, velocity=pan)
        scene = eqx.tree_at(lambda s: s.speeds, SCENE, speeds)
        shutter = SplineShutter(profile)
        values = {name: loss(scene, motion, shutter) for name, loss in LOSSES.items()}
        metrics = evaluate(scene, motion, shutter)
        within = {name for name, metric in METRICS.items() if metric.within_tolerances}
        return values | {name: getattr(metrics, name) for name in METRICS if name not in within}

    speeds = np.asarray(SCENE.speeds)
    good = rates, 0.012, 50.0, speeds, PROFILE
    mirrored = -rates, 0.012, -50.0, -speeds, PROFILE
    holes = [
        (rates * np.nan, *good[1:]),
        (rates, np.nan, *good[2:]),
        (rates, 0.012, np.nan, *good[3:]),
        (*good[:4], PROFILE * np.nan),
        (rates, -0.012, *good[2:]),
    ]
    rows = tuple(np.stack(column) for column in zip(good, mirrored, *holes, strict=True))
    for name, values in jax.jit(jax.vmap(measured))(rows).items():
        values = np.asarray(values)
        assert np.isfinite(values[0]), name
        assert values[1] == pytest.approx(values[0], rel=1e-9), name
        assert np.all(np.isnan(values[2:])), (name, values)
