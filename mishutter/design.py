"""A finished design: kept, written to one file, and read back to the same numbers."""

import json
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from mishutter.files import strict_json, write_text
from mishutter.metrics import Metrics, evaluate
from mishutter.motion import AbstractMotion, ParabolicMotion, StillCamera
from mishutter.plan import Plan
from mishutter.scene import Limits, Scene
from mishutter.shutters import (
    AbstractShutter,
    ChippedShutter,
    GaussianShutter,
    HannShutter,
    RectShutter,
    SplineShutter,
    TriangleShutter,
    TukeyShutter,
)
from mishutter.shutters.base import profile_of
from mishutter.types import require

FORMAT = 1
_PROFILE_POINTS = 1001


@dataclass(frozen=True)
class Design:
    """A shutter and a motion, how good they are, and how they were found.

    Attributes:
        shutter: The profile.
        motion: The sensor's motion.
        scene: The scene it was designed for.
        loss: Final loss.
        history: Smallest loss so far: after each step of the descents, or each start of a
            grid, and last after the polish.
        converged: Whether the search met its tolerance.
        outcome: How the search ended, in a sentence.
        certificate: Projected-gradient norm in the unit box of designs.
        loss_name: The loss that was made small.
        best_start_loss: Smallest loss among the starts.
        plan: What the search computed; None where that is not known.
    """

    shutter: AbstractShutter
    motion: AbstractMotion
    scene: Scene
    loss: float
    history: np.ndarray
    converged: bool
    outcome: str
    certificate: float
    loss_name: str
    best_start_loss: float
    plan: Plan | None = None

    @cached_property
    def metrics(self) -> Metrics:
        """What is measured of it on its scene; computed where it is asked for."""
        return evaluate(self.scene, self.motion, self.shutter)

    def to_dict(self) -> dict[str, Any]:
        """Everything in the design as plain numbers, lists and text."""
        return {
            "format": FORMAT,
            "mishutter": package_version(),
            "shutter": shutter_to_dict(self.shutter),
            "motion": motion_to_dict(self.motion),
            "scene": scene_to_dict(self.scene),
            "loss": self.loss,
            "loss_name": self.loss_name,
            "best_start_loss": self.best_start_loss,
            "metrics": metrics_to_dict(self.metrics),
            "history": [float(x) for x in self.history],
            "converged": self.converged,
            "outcome": self.outcome,
            "certificate": self.certificate,
            "plan": None if self.plan is None else self.plan.to_dict(),
        }

    def save(self, path: str | Path) -> None:
        """Write the design to one JSON file, whole or not at all.

        Raises:
            ValueError: if the shutter is of a kind that the file format does not know.
            OSError: if the file cannot be written.
        """
        write_text(path, strict_json(self.to_dict()) + "\n")

    @staticmethod
    def load(path: str | Path) -> "Design":
        """Read a design; its metrics are evaluated anew.

        Raises:
            ValueError: if the file is not a design of this format.
            OSError: if it cannot be read.
        """
        subject = f"Design.load(path={str(path)!r})"
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"`{subject}` must be a JSON file; got {error}.") from None
        is_design = isinstance(data, dict) and "format" in data
        require(is_design, subject, "be a design saved by mishutter", type(data).__name__)
        known = data["format"] == FORMAT
        require(known, subject, f"be of design format {FORMAT}", f"format {data['format']}")
        try:
            return _from_dict(data)
        except (KeyError, TypeError, AttributeError) as error:
            what = f"{type(error).__name__} {error}"
            raise ValueError(f"`{subject}` must be a complete design; got {what}.") from None

    def write_profile(self, path: str | Path) -> None:
        """Write the profile as CSV with a line of units: time, normalised time, transmittance.

        Raises:
            OSError: if the file cannot be written.
        """
        tau = np.linspace(-1, 1, _PROFILE_POINTS)
        dtype = self.motion.half_exposure.dtype
        transmittance = np.asarray(profile_of(self.shutter, tau.astype(dtype))[0])
        time = tau * float(self.motion.half_exposure) * 1e3
        rows = [
            f"{t:.9g},{x:.9g},{w:.9g}" for t, x, w in zip(time, tau, transmittance, strict=True)
        ]
        write_text(path, "\n".join(["time,tau,transmittance", "ms,1,1", *rows]) + "\n")


def package_version() -> str:
    """Version of the installed package."""
    try:
        return version("mishutter")
    except PackageNotFoundError:
        return "unknown"


def metrics_to_dict(metrics: Metrics) -> dict[str, float | int]:
    """Metrics as plain numbers."""
    return {
        name: value if isinstance(value, int) else float(value)
        for name, value in vars(metrics).items()
    }


def motion_to_dict(motion: AbstractMotion) -> dict[str, Any]:
    """Kind and numbers of a motion."""
    return {
        "kind": type(motion).__name__,
        "acceleration": float(motion.acceleration),
        "half_exposure": float(motion.half_exposure),
    }


def shutter_to_dict(shutter: AbstractShutter) -> dict[str, Any]:
    """Kind and parameters of a shutter.

    Raises:
        ValueError: if it is not one of the package's own kinds.
    """
    kind = type(shutter)
    known = kind in _PARAMETER_OF
    require(known, "Design.save(shutter=...)", "be one of mishutter's own kinds", kind.__name__)
    data: dict[str, Any] = {"kind": kind.__name__}
    name = _PARAMETER_OF[kind]
    if name is not None:
        data[name] = np.asarray(getattr(shutter, name), np.float64).tolist()
    if isinstance(shutter, SplineShutter):
        data |= {"symmetric": shutter.symmetric, "num_coefficients": shutter.num_coefficients}
    return data


def scene_to_dict(scene: Scene) -> dict[str, Any]:
    """Numbers of a scene."""

    def plain(value: Any) -> Any:
        return None if value is None else np.asarray(value, np.float64).tolist()

    return {
        "speeds": plain(scene.speeds),
        "weights": plain(scene.weights),
        "photon_rate": plain(scene.photon_rate),
        "read_noise": plain(scene.read_noise),
        "mean_level": plain(scene.mean_level),
        "deviation": plain(scene.deviation),
        "power_spectrum": plain(scene.power_spectrum),
        "cutoff_frequency": plain(scene.cutoff_frequency),
        "limits": {name: plain(value) for name, value in vars(scene.limits).items()},
        "picture": scene.picture,
    }


_PARAMETER_OF: dict[type[AbstractShutter], str | None] = {
    RectShutter: None,
    HannShutter: None,
    TriangleShutter: None,
    GaussianShutter: "sigma",
    TukeyShutter: "taper",
    ChippedShutter: "transmittances",
    SplineShutter: "parameters",
}


def _from_dict(data: dict[str, Any]) -> Design:
    shutter = shutter_from_dict(data["shutter"])
    motion = _motion_from_dict(data["motion"])
    scene_data: dict[str, Any] = {
        name: np.array(value) if isinstance(value, list) else value
        for name, value in data["scene"].items()
    }
    limits = Limits(**scene_data.pop("limits"))
    speeds, weights = scene_data.pop("speeds"), scene_data.pop("weights")
    scene = Scene(speeds, weights, limits=limits, motion=motion, **scene_data)
    return Design(
        shutter=shutter,
        motion=motion,
        scene=scene,
        loss=float(data["loss"]),
        history=np.array(data["history"]),
        converged=bool(data["converged"]),
        outcome=str(data["outcome"]),
        certificate=float(data["certificate"]),
        loss_name=str(data["loss_name"]),
        best_start_loss=float(data["best_start_loss"]),
        plan=Plan.from_dict(data["plan"]) if data.get("plan") else None,
    )


def shutter_from_dict(data: dict[str, Any]) -> AbstractShutter:
    """The shutter that `shutter_to_dict` wrote.

    Raises:
        ValueError: if its kind is not known.
    """
    kinds = {kind.__name__: kind for kind in _PARAMETER_OF}
    known = data["kind"] in kinds
    require(known, "Design.load(shutter kind)", f"be one of {', '.join(kinds)}", data["kind"])
    arguments = {name: value for name, value in data.items() if name != "kind"}
    for name, value in arguments.items():
        if isinstance(value, list):
            arguments[name] = np.array(value)
    return kinds[data["kind"]](**arguments)


def _motion_from_dict(data: dict[str, Any]) -> AbstractMotion:
    if data["kind"] == "StillCamera":
        return StillCamera(half_exposure=data["half_exposure"])
    return ParabolicMotion(acceleration=data["acceleration"], half_exposure=data["half_exposure"])
