"""Pure geometry: cameras, poses, flat ports, rays, triangulation and the laser beam. NumPy only."""

from leadline.geometry.beam import Beam, refract_direction
from leadline.geometry.camera import Camera
from leadline.geometry.pose import Pose
from leadline.geometry.refraction import LayeredPort
from leadline.geometry.triangulation import midpoints, triangulate

__all__ = ["Beam", "Camera", "LayeredPort", "Pose", "midpoints", "refract_direction", "triangulate"]
