"""Pictures of the arm; what draws them (`renderer`, `window`) needs pygame-ce.

``pip install "octoarm-env[render]"`` brings it. Cameras, and putting pictures side by side, do
without.
"""

from octoarm_env.rendering.camera import CAMERAS, Camera
from octoarm_env.rendering.tiles import tile_images

__all__ = ["CAMERAS", "Camera", "tile_images"]
