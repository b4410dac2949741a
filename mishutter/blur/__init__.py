"""The exposure integral: trajectories, crossings, kernels and transfer functions."""

from mishutter.blur.crossings import safe_sqrt as safe_sqrt
from mishutter.blur.kernel import aligned_kernel as aligned_kernel
from mishutter.blur.kernel import binned_exposure as binned_exposure
from mishutter.blur.kernel import blur_kernel as blur_kernel
from mishutter.blur.quadrature import ExposureQuadrature as ExposureQuadrature
from mishutter.blur.quadrature import exposure_quadrature as exposure_quadrature
from mishutter.blur.quadrature import mean_transmittance as mean_transmittance
from mishutter.blur.spectrum import condition_number as condition_number
from mishutter.blur.spectrum import default_num_frequencies as default_num_frequencies
from mishutter.blur.spectrum import transfer_function as transfer_function
from mishutter.blur.waves import BLOCK as BLOCK
from mishutter.blur.waves import sum_of_waves as sum_of_waves
from mishutter.blur.waves import waves_of_blocks as waves_of_blocks
from mishutter.blur.waves import waves_on_dft as waves_on_dft
