"""Names of observations, which are LeRobot's."""

IMAGE_PREFIX = "observation.images."
"""What the key of a camera's images begins with; the camera's name follows."""
