"""The oracle: films of the experiment whose answers are known exactly.

Describe what stands on the table (`Scene`, `Marker`, `Wobble`), how it moves (`Motion`, `two_body_motion`),
who looks (`Camera`, `Light`), and draw it (`render_clip`, or `Renderer` for single frames). The answers come
back as `Truth`. Someone who doubts the settings of a measurement can draw the own scene and measure how well
it is tracked.
"""

from gyrotrack.synthetic.clip import render_clip
from gyrotrack.synthetic.film import Film, write_film
from gyrotrack.synthetic.motion import Friction, Motion, two_body_motion
from gyrotrack.synthetic.optics import Camera, Light
from gyrotrack.synthetic.render import Renderer
from gyrotrack.synthetic.scene import BLUE, GREEN, PAPERS, RED, WHITE, Marker, Scene, Wobble
from gyrotrack.synthetic.truth import Truth, find_truth, load_truth

__all__ = [
    "BLUE",
    "GREEN",
    "PAPERS",
    "RED",
    "WHITE",
    "Camera",
    "Film",
    "Friction",
    "Light",
    "Marker",
    "Motion",
    "Renderer",
    "Scene",
    "Truth",
    "Wobble",
    "find_truth",
    "load_truth",
    "render_clip",
    "two_body_motion",
    "write_film",
]
