"""The one form of known shutters is the shutter itself, to rounding, for every kind it holds."""

from typing import ClassVar, final

import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import SHUTTERS
from support.programs import compiled_programs

from mishutter import (
    ChippedShutter,
    GaussianShutter,
    HannShutter,
    ParabolicMotion,
    RectShutter,
    SplineShutter,
    StillCamera,
    TriangleShutter,
    TukeyShutter,
    blur_kernel,
    evaluate,
    example_scene,
)
from mishutter.evaluation.response import kernels_at_speeds
from mishutter.model.shutters.base import AbstractPiecewiseShutter
from mishutter.model.shutters.polynomials import PolynomialShutter, in_one_form

ROUNDING = {np.float64: 1e-15, np.float32: 4e-7}
"""A few last digits of a transmittance of one."""
STEEPEST = 50
"""Roundings of a transmittance that one of time is worth on the steepest ramp."""
OWN_FORM = {"gaussian-narrow", "tukey-steep", "flutter", "one-open-chip"}
"""Those that bend too sharply in double precision, or have too short or too many pieces."""
MOTIONS = [
    ParabolicMotion(acceleration=4.7e5, half_exposure=0.0093),
    StillCamera(half_exposure=0.0093),
]


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ROUNDING)
@pytest.mark.parametrize("slug", SHUTTERS)
def test_the_form_is_the_shutter(slug, dtype):
    """Transmittance and efficiency are the same, in the same precision."""
    shutter = SHUTTERS[slug].shutter(dtype)
    form = in_one_form(shutter, np.dtype(dtype))
    if dtype is np.float64:
        assert (form is shutter) == (slug in OWN_FORM)
    tau = np.linspace(-1.0007, 0.9987, 211).astype(dtype)
    value, expected = (np.asarray(x.transmittance(tau)) for x in (form, shutter))
    assert value.dtype == dtype
    np.testing.assert_allclose(value, expected, atol=STEEPEST * ROUNDING[dtype])
    np.testing.assert_allclose(form.efficiency(), shutter.efficiency(), atol=ROUNDING[dtype])


def test_the_form_of_a_known_shutter_takes_no_program(caplog):
    """Of each kind of the package, some in shapes that nothing else here has."""
    known = [
        SplineShutter(np.linspace(0.1, 0.9, 11)),
        SplineShutter(np.linspace(0.1, 0.9, 7), symmetric=True),
        ChippedShutter(np.linspace(0.1, 0.9, 5)),
        *(TukeyShutter(0.3), GaussianShutter(0.6)),
        *(RectShutter(), HannShutter(), TriangleShutter()),
    ]
    with compiled_programs(caplog) as programs:
        forms = [in_one_form(shutter, np.dtype(float)) for shutter in known]
    assert all(isinstance(form, PolynomialShutter) for form in forms)
    assert not programs


@final
class Ramps(AbstractPiecewiseShutter):
    """A triangle of somebody else's, whose breakpoints are NumPy's and whose values JAX's."""

    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True

    def transmittance(self, tau):
        return TriangleShutter().transmittance(tau)

    def breakpoints(self, dtype):
        return np.array([-1, 0, 1], dtype)

    def piece_transmittance(self, offset):
        return jnp.stack([offset[0], 1 - offset[1]])

    def piece_mean(self, piece, from_left, distance, width):
        return TriangleShutter().piece_mean(piece, from_left, distance, width)


@pytest.mark.slow
def test_a_piecewise_shutter_of_ones_own_has_the_form_too():
    """Its metrics are those of the window that it copies."""
    assert isinstance(in_one_form(Ramps(), np.dtype(float)), PolynomialShutter)
    scene, motion = example_scene(), MOTIONS[0]
    own, window = (evaluate(scene, motion, x) for x in (Ramps(), TriangleShutter()))
    np.testing.assert_allclose(own.expected_psnr, window.expected_psnr, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("slug", SHUTTERS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_kernels_of_known_speeds_are_those_of_the_shutter(slug, motion):
    """Those by the shared program, against `blur_kernel`, which takes the shutter as it is."""
    shutter, speeds = SHUTTERS[slug].shutter(), np.array([0.0, 310.0, -1700.0, 4100.0])
    kernels = np.asarray(kernels_at_speeds(shutter, motion, speeds, 128))
    assert kernels.max() > 0.01
    if motion.is_straight:
        assert np.isclose(kernels[0].max(), shutter.efficiency(), rtol=1e-14)
        return
    exact = blur_kernel(shutter, motion, num_taps=128)
    np.testing.assert_allclose(kernels[0], exact, rtol=0, atol=ROUNDING[np.float64])


@pytest.mark.parametrize("taper", [0.0, 1e-9, 1e-4, 0.999999])
def test_pieces_of_hardly_any_length_keep_their_shutter(taper):
    """Times that a moment does not tell apart are left to the shutter that counts from them."""
    assert in_one_form(TukeyShutter(taper), np.dtype(float)).breakpoints(np.dtype(float)).size == 4
