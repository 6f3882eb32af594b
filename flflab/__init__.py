"""Focused light field camera: its model, pictures, their measurement, and the comparison of the
two.
"""

from flflab.kernel_cache import use_kernel_cache

use_kernel_cache()
