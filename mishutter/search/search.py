"""The design search: a cover, minima from the lowest starts, a polish, and an honest end."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from mishutter._core.checks import require, require_known, require_positive_int, require_seed
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas, in_threads, num_processors
from mishutter._core.progress import reports
from mishutter.design.design import Design, OneExposure, Outcome
from mishutter.evaluation.losses import AbstractLoss, LossFunction, as_loss, value_of
from mishutter.evaluation.metrics import evaluate
from mishutter.evaluation.needs import Plan
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE, loss_of_decoder
from mishutter.evaluation.views import require_numbers, transmittance
from mishutter.model.devices import AbstractDevice, command_of, stays_open
from mishutter.model.exposures import Exposures
from mishutter.model.motion import AbstractMotion, is_known_zero
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter, check_bounds, is_adjustable
from mishutter.model.shutters.chips import ChippedShutter
from mishutter.model.shutters.spline import SplineShutter
from mishutter.model.shutters.windows import RectShutter, TukeyShutter
from mishutter.search.bursts import choose_burst, shown_bursts
from mishutter.search.objective import AbstractObjective, SearchedObjective, objective_of
from mishutter.search.planning import design_at
from mishutter.search.planning import plan as plan_of_scene
from mishutter.search.rows import OWN_BEST_MOTION, Row
from mishutter.search.slots import searched_slots
from mishutter.search.solvers import (
    Polished,
    certificate_at,
    finished,
    is_minimum,
    losses_at,
    minimise,
    polish,
)
from mishutter.search.space import (
    DesignSpace,
    all_that_can_move,
    beyond_limits,
    design_space,
    mirrors,
    search_frame,
)
from mishutter.search.starts import (
    GRID_COORDINATES,
    cover,
    lowest_of_valleys,
    lowest_places,
    point_at,
    screened,
    start_boxes,
)

_TRIED_SHARE, _FIRST_STEPS = 3, 60
"""The lowest third of the starts is tried for 60 steps: after 20 the leaders are not yet those that
end lowest, where speeds are few and the light is bright."""
_NUM_LASTING, _LASTING_SHARE = 4, 8
"""Least number of tries to minimise from, and starts for each of them: early leaders may end in one
place."""
_NUM_POLISHED = 3
"""Points to polish: minima that differ, or starts where these are few."""
_SAME = 1e-5
"""Difference of losses, as a share of them, up to which two searches ended in one place."""
MAX_STEPS = 400
"""Steps of a minimisation, and of a polish, at most, by default."""
NUM_COEFFICIENTS = 24
"""Coefficients of a free-form profile, by default."""

Progress = Callable[[int, float], None]

_OUTSIDE = "A fixed part of the motion is outside the scene's limits."


class SearchSettings(NamedTuple):
    """Settings that a search shares with all searches that it calls for."""

    loss: AbstractLoss  # The loss to be minimised
    # The plan of the computation, by which searches share programs; by default each search has its
    # own, made for its whole space
    plan: Plan | None = None
    # Coefficients of a free-form profile that is made here
    num_coefficients: int = NUM_COEFFICIENTS
    num_starts: int | None = None  # Number of starts; None for the default
    seed: int = 0  # Seed of the random starts
    max_steps: int = MAX_STEPS  # Steps of a minimisation, at most
    progress: Progress | None = None  # Called with the steps taken and the smallest loss so far

    def plan_of(self, scene: Scene, space: DesignSpace) -> Plan:
        """The plan of these settings, or one that is made for a whole space."""
        if self.plan is not None:
            return self.plan
        start = scene, space.motion, space.shutter
        return plan_of_scene(*start, loss=self.loss, free=space.free).sizes


class Start(NamedTuple):
    """The arguments of `optimise` that define the problem of a search."""

    scene: Scene  # Speeds, light, noise and limits
    motion: AbstractMotion | None = None  # Motion to start from; None for the scene's
    shutter: AbstractShutter | None = None  # Profile to start from; None for one of free form
    free: tuple[str, ...] | None = None  # Parts that may move; None for the default
    more: tuple[Design, ...] = ()  # Designs to start from as well


class SearchFailedError(RuntimeError):
    """A search with `throw=True` did not converge."""


@alone_in_blas()
@outside_trace()
def optimise(
    scene: Scene,
    motion: AbstractMotion | None = None,
    shutter: AbstractShutter | None = None,
    *,
    loss: LossFunction | None = None,
    free: str | Iterable[str] | None = None,
    num_coefficients: int = NUM_COEFFICIENTS,
    num_starts: int | None = None,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
    progress: Progress | bool | None = None,
    throw: bool = False,
    bursts: tuple[Exposures, ...] = (),
) -> Design:
    r"""Search for the design of least loss within the scene's limits.

    Where the acceleration may move, sensors that do not accelerate are searched as well, and the
    better of the two designs is returned; of equals, the one without acceleration. Where the speeds
    are the same in both directions and the search starts without a pan, none is tried unless `free`
    names the velocity: by symmetry the loss is stationary there. By a loss that ignores how much
    light an exposure brings, as `DesignLoss`, the profile alone moves unless `free` says otherwise:
    on the `motion`, on the scene's, or on that of the best design by the expected error.

    Starts are the first design, baselines' profiles and points all over the space, and behind a
    device that is late, or has few levels, the best design for one that follows every command. The
    lowest are minimised and polished; the result is never worse than the best of them.

    Where acceleration moves, a design keeps up ($2aT$) with every object that occurs or with those
    that `motion` keeps up with, whichever are fewer: a `motion` within the limits is always a
    start, and one that gives up rare fast objects lets the search give them up too.
    Where the decoder knows the speed of a camera with a `BurstMode`, the best frames are
    `Design.sequence`, if they are better than the exposure and `free` names none of its parts.

    Args:
        scene: Speeds, light, noise and limits.
        motion: Motion to start from, the scene's by default; a `StillCamera` stays at rest, and a
            `LinearMotion` does not accelerate.
        shutter: Profile to start from, as it is sent to the scene's device, of the kind to search;
            by default the free-form `starting_shutter` of the scene.
        loss: The loss to be minimised, or a function of scene, motion and shutter; the
            expected error by default, of the decoder that the scene names.
        free: Parts that may move: `"shutter"`, `"half_exposure"`, `"velocity"`, `"acceleration"`;
            by default all that can, unless the loss ignores light.
        num_coefficients: Coefficients of the free-form profile without a `shutter`.
        num_starts: Number of starts; by default 12 for a profile alone, 16 otherwise, and more
            for few speeds.
        seed: Seed of the random starts.
        max_steps: Steps of each minimisation, and of the polish, at most.
        progress: True shows a bar; a function is called with the steps taken and the least loss.
        throw: Whether an end other than convergence raises.
        bursts: The best bursts, where an earlier search has found them.

    Returns:
        The best design, its `outcome`, which is the end of the search, and as a certificate the
        norm of the projected gradient; `notes` say where a fixed part is outside the limits.

    Raises:
        ValueError: if `free` names nothing that can move, a count is not positive, `seed` is
            negative, or `loss` is no loss, or its value not one real number; or if JAX traces
            the scene, the motion or the shutter.
        NonFiniteLossError: if the loss or its gradient is not finite.
        SearchFailedError: if `throw` and the search did not converge.

    Examples:
        >>> from mishutter import Limits, Scene, TukeyShutter, optimise
        >>> limits = Limits(max_stroke=20, max_half_exposure=0.02)
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5, limits=limits)
        >>> design = optimise(scene, shutter=TukeyShutter(0.5))
        >>> print(f"taper {design.shutter.taper:.2f}, {design.metrics.expected_psnr:.2f} dB")
        taper 0.78, 29.09 dB
    """
    require_scene(scene)
    require_known("optimise", scene=scene, motion=motion, shutter=shutter)
    is_motion = isinstance(motion, AbstractMotion | None)
    require(is_motion, "optimise(motion=...)", "be a motion", motion)
    is_shutter = isinstance(shutter, AbstractShutter | None)
    require(is_shutter, "optimise(shutter=...)", "be a shutter, as `HannShutter()`", shutter)
    for part in filter(None, (motion, shutter)):
        require_numbers(part)
    shutter = None if shutter is None else command_of(shutter)
    if scene.sensor.is_rolling:
        shutter = RectShutter() if shutter is None else shutter
        requirement = (
            "be open, as `RectShutter()`, before rows that are exposed one after another: each "
            "would see another part of a profile"
        )
        is_open = isinstance(shutter, RectShutter)
        require(is_open, "optimise(shutter=...)", requirement, shutter)
    if num_starts is not None:
        require_positive_int("optimise(num_starts=...)", num_starts)
    require_positive_int("optimise(max_steps=...)", max_steps)
    require_seed("optimise(seed=...)", seed)
    loss = as_loss(loss_of_decoder(scene) if loss is None else loss, "optimise(loss=...)")
    names = (free,) if isinstance(free, str) else None if free is None else tuple(free)
    if shutter is not None and (names is None or "shutter" in names):
        check_bounds(shutter)
    with reports(
        progress,
        "searching",
        max_steps,
        words=lambda step, loss: (step, f"loss {loss:.6g}"),
        why="compiling, or a long minimisation",
    ) as news:
        settings = SearchSettings(loss, None, num_coefficients, num_starts, seed, max_steps, news)
        best = best_design(Start(scene, motion, shutter, names), settings)
    decoder = loss.decoder_speed
    if names is None and decoder is not None and SPEED_KNOWLEDGE[decoder].knows_speed:
        found = bursts or shown_bursts(scene, is_shown=progress is True)
        best = _beside_bursts(best, loss, found)
    elif bursts:
        best = replace(best, bursts=bursts)
    if throw and not best.converged:
        raise SearchFailedError(best.ending)
    return best


def _beside_bursts(design: Design, loss: AbstractLoss, bursts: tuple[Exposures, ...]) -> Design:
    """A design, and the frames to take in its place where these are better."""
    scene = design.scene
    # Before a background bursts are told more than one exposure, with which they do not compare.
    level = -math.inf if scene.occlusion is not None else next(iter(design.levels.values()))
    one = Exposures.of_one(design.motion, design.shutter, scene.limits)
    row = Row(OWN_BEST_MOTION, "", one, None, design.metrics)
    instead = choose_burst(bursts, level, row.rank, at_worst=loss.of_worst_speed)
    return replace(design, bursts=bursts, sequence=instead)


@alone_in_blas()
@outside_trace()
def best_design(start: Start, settings: SearchSettings) -> Design:
    """`optimise`, for callers that share a plan between searches."""
    scene, _, shutter, names, _ = start
    device = scene.device
    moves = shutter is None or is_adjustable(shutter) if names is None else "shutter" in names
    if moves and device is not None and (device.lags or device.levels is not None):
        best = _through_device(start, settings)
    else:
        best = _optimised(start, settings)
    return _without_needless_device(best, settings.loss)


def _without_needless_device(design: Design, loss: AbstractLoss) -> Design:
    """A design as its profile is measured: one that has come to stay open needs no device.

    A search compares profiles behind the device, where nothing jumps, so that this is for its end.
    """
    if design.scene.device is None:
        return design
    scene, motion, command = design.scene, design.motion, design.command
    if design.straight is not None:
        design = design.with_one(straight=_without_needless_device(design.straight, loss))
    if design.shutter is command or not stays_open(command):
        return design
    value, notes = float(value_of(loss, scene, motion, command)), design.notes
    if beyond_limits(scene, motion, command) and _OUTSIDE not in notes:
        notes = (*notes, _OUTSIDE)
    history = np.append(design.history, value)
    return design.with_one(shutter=command, loss=value, history=history, notes=notes)


def _optimised(start: Start, settings: SearchSettings) -> Design:
    """The best design of a transmittance that can be differentiated by the coordinates."""
    scene, motion, shutter, names, _ = start
    if names is None:
        motion, names = moved_by_default(scene, motion, shutter, settings.loss)
    best, *others = _searched(start._replace(motion=motion, free=names), settings)
    if not others:
        return best
    (straight,) = others
    history = np.append(best.history, np.minimum(straight.history, best.history[-1]))
    start_loss = min(best.best_start_loss, straight.best_start_loss)
    # The design without acceleration needs no stage, and is better among equals.
    if straight.loss <= best.loss * (1 + _SAME):
        note = "Acceleration does not pay: at constant velocity the loss is no larger."
        best = straight.with_one(notes=(*straight.notes, note))
    best = best.with_one(history=history, best_start_loss=start_loss)
    return best.with_one(straight=straight) if {"shutter", "half_exposure"} <= {*names} else best


def _through_device(start: Start, settings: SearchSettings) -> Design:
    """The best design by the transmittance that a device makes of its command.

    The design for a device that follows every command comes first, and is among the starts, sent
    to the real device. Levels are left out until the end, and then searched slot by slot.
    """
    scene = start.scene
    device: AbstractDevice = scene.device  # type: ignore[assignment]
    ideal = with_device(scene, device.without_lag)
    blind = best = _optimised(start._replace(scene=ideal), settings)
    if device.lags:
        relaxed = with_device(scene, device.relaxed)
        more = tuple(filter(None, (blind, blind.straight)))
        best = _optimised(start._replace(scene=relaxed, more=more), settings)
    if device.levels is not None:
        best = _of_levels(scene, (best, blind), start.free, settings)
    profile = transmittance(scene, blind.motion, blind.command)
    psnr_ignoring_lag = float(evaluate(scene, blind.motion, profile).expected_psnr)
    return replace(best, scene=scene).with_one(psnr_ignoring_lag=psnr_ignoring_lag)


def _of_levels(
    scene: Scene,
    designs: Sequence[Design],
    names: tuple[str, ...] | None,
    settings: SearchSettings,
) -> Design:
    """The better of designs for a device without levels, as good as its levels allow.

    A free-form command is rounded, and its slots and its motion are searched by turns.
    """
    loss = settings.loss
    sent = [_sent(scene, each.command, each.motion, each, loss) for each in designs]
    place = int(np.argmin([each.loss for each in sent]))
    start, best = designs[place], sent[place]
    if not isinstance(start.command, SplineShutter | ChippedShutter):
        return best
    if names is None:
        names = free_by_default(scene, start.motion, None) if loss.sees_light else ()
    movable = set(all_that_can_move(scene, start.motion, None)) - {"shutter"}
    names = tuple(name for name in names if name in movable)
    device: AbstractDevice = scene.device  # type: ignore[assignment]
    relaxed = with_device(scene, device.relaxed)
    # Levels have no slope along which they could move together with the motion: both are searched
    # by turns, three times at most.
    for _ in range(3):
        command: ChippedShutter = best.command  # type: ignore[assignment]
        of_slots, still = search_frame(relaxed, best.motion, ("shutter",))
        space = design_space(of_slots, still, command, "shutter")
        objective = objective_of(loss, of_slots, space, settings.plan_of(of_slots, space))
        slots = searched_slots(objective, np.asarray(command.transmittances), device)
        better = _sent(scene, ChippedShutter(slots), best.motion, best, loss)
        if names:
            tuned = _optimised(Start(relaxed, best.motion, better.command, names), settings)
            tuned = _sent(scene, better.command, tuned.motion, tuned, loss)
            better = min(better, tuned, key=lambda each: each.loss)
        worthwhile = better.loss < best.loss - _SAME * abs(best.loss)
        best = min(best, better, key=lambda each: each.loss)
        if not (worthwhile and names):
            break
    note = "No other level of one slot, or of two near one another, lowers the loss."
    return best.with_one(outcome=start.outcome, notes=(*start.notes, note))


def _sent(
    scene: Scene,
    command: AbstractShutter,
    motion: AbstractMotion,
    design: Design,
    loss: AbstractLoss,
) -> Design:
    """A design with the transmittance that the scene's device makes of a command."""
    device: AbstractDevice = scene.device  # type: ignore[assignment]
    profile = device.behind(command, motion.half_exposure, np.dtype(scene.speeds.dtype))
    value = float(loss(scene, motion, profile))
    history = np.append(design.history, value)
    sent = replace(design, scene=scene)
    return sent.with_one(shutter=profile, motion=motion, loss=value, history=history, straight=None)


def with_device(scene: Scene, device: AbstractDevice | None) -> Scene:
    """A scene with another device."""
    return eqx.tree_at(lambda s: s.device, scene, device, is_leaf=lambda part: part is None)


def moved_by_default(
    scene: Scene,
    motion: AbstractMotion | None,
    shutter: AbstractShutter | None,
    loss: AbstractLoss,
) -> tuple[AbstractMotion, tuple[str, ...]]:
    """The motion to start from, and the parts that a search by a loss moves by default.

    A loss that ignores light moves the profile alone, on the motion or on the scene's; without
    either, on that of the best design by the expected error.
    """
    start = scene.motion if motion is None else motion
    names = free_by_default(scene, start, shutter)
    if loss.sees_light or "shutter" not in names:
        return start, names
    if motion is None and scene.given_motion is None:
        best = best_design(Start(scene, start, shutter), SearchSettings(loss_of_decoder(scene)))
        start = best.motion
    return start, ("shutter",)


def free_by_default(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter | None
) -> tuple[str, ...]:
    """Parts that a search moves by default: all that can, but for a pan that symmetry rules out.

    Without a shutter the profile is of free form.
    """
    names = all_that_can_move(scene, motion, shutter)
    if float(motion.velocity) == 0 and mirrors(scene, 0.0):
        return tuple(name for name in names if name != "velocity")
    return names


def _searched(start: Start, settings: SearchSettings) -> list[Design]:
    """The best design, and where the acceleration may move the best without acceleration."""
    frame = start.scene.motion if start.motion is None else start.motion
    shutter, names, more = start.shutter, start.free or (), start.more
    scene, motion = search_frame(start.scene, frame, names)
    if shutter is None:
        pans = "velocity" in names
        # A velocity that is fixed cannot come to the middle of the speeds, about which a profile of
        # a panning camera would be symmetric.
        at_rest = scene if pans else scene.without_pan()
        shutter = starting_shutter(at_rest, settings.num_coefficients)
    space = design_space(scene, motion, shutter, names)
    plan = settings.plan_of(scene, space)
    best = [_best_of_space(scene, space, plan, settings, more)]
    # The logarithmic coordinate of the acceleration does not reach 0, where a camera may be best.
    if "acceleration" in space.free:
        settings = settings._replace(progress=None)
        best.append(_best_of_space(scene, space.without_acceleration(), plan, settings, more))
    designs = []
    for design in best:
        motion = design.motion
        if "velocity" not in names and not is_known_zero(frame.velocity):
            motion = motion.panned(frame.velocity)
        is_outside = beyond_limits(start.scene, motion, design.shutter)
        notes = (_OUTSIDE,) if is_outside else ()
        designs.append(replace(design, scene=start.scene).with_one(motion=motion, notes=notes))
    return designs


def _best_of_space(
    scene: Scene,
    space: DesignSpace,
    plan: Plan,
    settings: SearchSettings,
    more: tuple[Design, ...],
) -> Design:
    """The best design of a space: minimised from the lowest starts, polished and certified."""
    max_steps, space = settings.max_steps, space.holding(each.motion for each in more)
    objective = objective_of(settings.loss, scene, space, plan)
    starts = _starts(objective, space, scene, settings, more)
    losses = losses_at(objective, starts.boxes)
    boxes = starts.boxes[np.argsort(losses, kind="stable")]
    history = _History(losses, settings)
    if starts.num_tried:
        boxes = _minima(objective, boxes[: starts.num_tried], starts.num_lasting, history)
    # After so many steps of each polish the best one goes on alone.
    ends = _polished(objective, boxes[: starts.num_polished], min(60, max_steps), history)
    end = finished(objective, ends[0], space.bends, max_steps=max_steps)
    point, value, certificate = end.point, end.loss, end.certificate
    lowest = int(np.argmin(losses))
    if float(losses[lowest]) < value:
        point, value = starts.boxes[lowest], float(losses[lowest])
        certificate = certificate_at(objective, point, space.bends)
    history.add(np.append(end.history, value))
    shutter, motion = design_at(space, point)
    if plan.num_effective_speeds:  # one design can afford more of them than all that are tried
        value = float(value_of(settings.loss, scene, motion, shutter))
    outcome = Outcome.STEPS_USED if end.num_steps >= max_steps else Outcome.STALLED
    one = OneExposure(
        shutter=shutter,
        motion=motion,
        loss=value,
        history=history.losses,
        outcome=Outcome.CONVERGED if is_minimum(certificate, value) else outcome,
        certificate=certificate,
        loss_name=repr(settings.loss),
        best_start_loss=float(losses[lowest]),
    )
    return Design(scene, one=one)


class _History:
    """The smallest loss so far, which `progress` reports."""

    def __init__(self, losses: Float[np.ndarray, "n"], settings: SearchSettings) -> None:
        self.losses, self.max_steps = np.minimum.accumulate(losses), settings.max_steps
        self._progress, self._num_steps = settings.progress, 0

    def add(self, losses: Float[np.ndarray, "k"], num_steps: int | None = None) -> None:
        """Adds the losses after some steps, by default one for each step."""
        smallest = np.minimum.accumulate(np.append(self.losses[-1], losses))
        self.losses = np.append(self.losses, smallest[1:])
        self._num_steps += losses.size if num_steps is None else num_steps
        if self._progress is not None:
            self._progress(min(self._num_steps, self.max_steps), float(self.losses[-1]))


def _polished(
    objective: AbstractObjective,
    boxes: Float[np.ndarray, "n size"],
    max_steps: int,
    history: _History,
) -> list[Polished]:
    """Ends of a polish of each point, the lowest first."""
    ends = []
    call = partial(polish, objective, max_steps=max_steps)
    for end in in_threads(call, boxes, num_processors()):
        history.add(end.history)
        ends.append(end)
    return sorted(ends, key=lambda end: end.loss)


def _minima(
    objective: AbstractObjective,
    boxes: Float[np.ndarray, "n size"],
    num_lasting: int,
    history: _History,
) -> Float[np.ndarray, "k size"]:
    """Minima that differ, the lowest first, from the points that the first steps lower most."""
    max_steps = history.max_steps
    tried = _polished(objective, boxes, min(_FIRST_STEPS, max_steps), history)[:num_lasting]
    places = _differing([end.loss for end in tried])
    # The tried points stay candidates: BFGS begins inside the bounds, and may end above them.
    points = [tried[place].point for place in places]
    losses = [tried[place].loss for place in places]
    call = partial(minimise, objective, max_steps=max_steps)
    for point, num_steps in in_threads(call, list(points), num_processors()):
        loss = losses_at(objective, point[None])
        history.add(loss, num_steps)
        points.append(point)
        losses.append(float(loss[0]))
    return np.stack(points)[_differing(losses)]


def _differing(losses: Sequence[float]) -> Int[np.ndarray, "k"]:
    """Places of the losses that differ, the lowest first."""
    order = np.argsort(losses, kind="stable")
    ascending = np.array(losses)[order]
    return order[np.diff(ascending, prepend=-np.inf) > _SAME * np.abs(ascending)]


class _Starts(NamedTuple):
    """Points to start from, and what becomes of them."""

    boxes: Float[np.ndarray, "n size"]
    num_polished: int = _NUM_POLISHED
    num_tried: int = 0  # Where none is tried, the lowest of the points are polished as they are
    num_lasting: int = 0  # Number of tries to minimise from


def _starts(
    objective: SearchedObjective,
    space: DesignSpace,
    scene: Scene,
    settings: SearchSettings,
    more: tuple[Design, ...],
) -> _Starts:
    """Starts of the search of a space."""
    has_spline = bool(space.num_profile_coordinates) and isinstance(space.shutter, SplineShutter)
    is_profile = has_spline and space.free == ("shutter",)
    # With few speeds a search takes less time and has more local minima, as each speed decides by
    # itself when the shutter is open.
    by_default = 12 if is_profile else 16 * max(1, 8 // objective.scene.speeds.size)
    num_starts = settings.num_starts or by_default
    starts = start_boxes(space, num_starts, settings.seed)
    before = [point_at(space, each.command, each.motion)[None] for each in more]
    # A grid covers few coordinates, and its lowest points are in the right valleys already.
    if space.size <= GRID_COORDINATES:
        if more:  # the best of the designs takes the place of the first
            designs = np.concatenate([*before, starts[:1]])
            starts[0] = designs[np.argmin(losses_at(objective, designs))]
        valleys = lowest_places(losses_at(objective, starts))[:_NUM_POLISHED]
        return _Starts(starts[np.union1d(0, valleys)])
    # A step costs a matrix product here, so that all starts are polished and none has to be tried.
    if is_profile:
        profiles = cover(space, scene, 5 * num_starts, settings.seed)
        boxes = np.concatenate([*before, starts, profiles.astype(starts.dtype)])
        count = num_starts + len(more)
        order = np.argsort(screened(objective, boxes), kind="stable")
        return _Starts(boxes[order[:count]], count)
    num_named = min(4, math.ceil(num_starts / 4))  # the first design and baselines' profiles
    if has_spline and num_named < num_starts:
        boxes = cover(space, scene, num_starts, settings.seed).astype(starts.dtype)
        losses, num_valleys = screened(objective, boxes), num_starts - num_named
        places = lowest_of_valleys(boxes, losses, space.num_profile_coordinates, num_valleys)
        starts = np.concatenate([starts[:num_named], boxes[places]])
    boxes = np.concatenate([*before, starts])
    num_tried = math.ceil(len(boxes) / _TRIED_SHARE)
    num_lasting = max(_NUM_LASTING, math.ceil(num_starts / _LASTING_SHARE))
    return _Starts(boxes, num_tried=num_tried, num_lasting=num_lasting)


@outside_trace()
def starting_shutter(scene: Scene, num_coefficients: int = NUM_COEFFICIENTS) -> SplineShutter:
    """The free-form profile a search starts from: symmetric if the scene's speeds are.

    Where turning the camera makes the pan, they may be symmetric about their middle; a stage, whose
    stroke holds its pan, may not reach that velocity. For a device that lags the profile is never
    symmetric: the command has to run ahead of the transmittance. Its precision is that of the
    speeds.

    Args:
        scene: The scene.
        num_coefficients: Coefficients of the profile.
    """
    require_scene(scene)
    require_known("starting_shutter", scene=(scene.speeds, scene.weights, scene.limits))
    slowest, fastest = (float(speed) for speed in scene.speed_range)
    middle = (slowest + fastest) / 2
    turns = scene.limits.pans == "camera" and abs(middle) <= float(scene.limits.max_pan)
    symmetric = mirrors(scene, middle if turns else 0.0)
    symmetric &= scene.device is None or not scene.device.lags
    taper = np.asarray(0.5, scene.speeds.dtype)
    return SplineShutter.fit(TukeyShutter(taper), num_coefficients, symmetric=symmetric)
