r"""The level that frames of given exposures do not exceed in the plane, whatever their paths.

By Parseval's theorem $\int|K_k|^2\,dq = D_k/|\mathbf f|$, and $|K_k| \le D_k$. So the signal over
the noise at a frequency has a budget over the components of the velocities, and a cap, and the
least error pours it like water (`mishutter.evaluation.ceilings`).
"""

import numpy as np
from jaxtyping import Float

from mishutter.evaluation.ceilings import water_filled
from mishutter.evaluation.fans import MEASURED, Fan, Grid
from mishutter.evaluation.levels import require_velocities
from mishutter.evaluation.open_frames import psnr_of_error
from mishutter.model.optics import pixel_response
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sensor import noise_power, white_electrons


def plane_ceiling(
    scene: Scene, exposures: Float[np.ndarray, "n"], *, grid: Grid = MEASURED
) -> float:
    """PSNR that no path of a sensor exceeds over frames of some exposures; dB.

    A list of velocities has the cap alone, as a path may dwell at each.
    """
    require_scene(scene, in_plane=True)
    fan, law = Fan.of(scene, grid), require_velocities(scene)
    each = np.asarray(white_electrons(float(scene.photon_rate), np.asarray(exposures)))
    noise = noise_power(1.0, float(scene.picture.mean_level), each, float(scene.read_noise))
    ratio = each / np.maximum(noise, 1e-12 * np.maximum(each, 1.0) ** 2)
    blur, direction = float(scene.optics.lens_blur), np.asarray(fan.direction)
    radius = np.asarray(fan.radius)[:, None]
    aperture = pixel_response(radius * np.cos(direction), blur)
    aperture = aperture * pixel_response(radius * np.sin(direction), blur)
    variance = float(scene.picture.deviation) ** 2
    signal = np.asarray(variance * fan.power * aperture**2)
    cap, cells = signal * np.sum(ratio * each), law.cells(128)
    lost = 1 / (1 + cap)
    if cells is not None:
        half = law.greatest(direction.ravel()).reshape(direction.shape)
        budget = signal * float(scene.photon_rate) * np.sum(ratio)
        budget = budget / np.maximum(radius * half, np.finfo(float).tiny)
        lost = water_filled(cells.mass, cells.width, np.minimum(budget, 2 * cap), cap)
    return psnr_of_error(variance * float(np.sum(fan.weight * lost)))
