"""The subject: a person of its own, denser than the model, with eyeballs, a larynx and skin detail, posed at any moment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from headcap.synthetic import lips, motion
from headcap.synthetic.anatomy import Fields, Places
from headcap.synthetic.larynx import Larynx
from headcap.synthetic.performance import CHANNELS
from headcap.synthetic.render import Surface
from headcap.synthetic.texture import Grain

AT_REST: dict[str, float] = dict.fromkeys(CHANNELS, 0.0)


@dataclass(frozen=True)
class Subject:
    """A subject that can be posed; all arrays belong to the resting head."""

    bare_m: NDArray[np.float64]
    """(n, 3) at rest, before the larynx lifts the throat."""
    surface: Surface
    lips_surface: Surface
    """The same with tattooed lips, for lip takes."""
    occluder: NDArray[np.int32]
    """(k, 3) fewer triangles over the same vertices, to cast shadows."""
    openness: NDArray[np.float64]
    """(n,) share of the sky seen at rest."""
    grain: Grain
    places: Places
    fields: Fields
    larynx: Larynx
    pulls: tuple[motion.Pull, ...]
    contact: lips.LipContact
    lids: tuple[motion.Lids, ...]
    """Left, right."""
    eyes: tuple[NDArray[np.int64], ...]
    """Vertices of the left and the right eyeball."""
    lip_zone: NDArray[np.int64]
    jaw_zone: NDArray[np.int64]
    outside: NDArray[np.bool_]
    """(m,) triangles a scanner sees: not the mouth's inside nor the backs of the eyes."""
    landmarks: dict[str, int] = field(default_factory=dict)
    inner_lips: tuple[NDArray[np.int64], ...] = ()
    """Three vertices each of the upper and lower inner lip, the middle one on the midline."""

    @property
    def rest_m(self) -> NDArray[np.float64]:
        """(n, 3) the resting subject."""
        return self.vertices(AT_REST)

    def vertices(self, state: dict[str, float]) -> NDArray[np.float64]:
        """Positions (n, 3), metres, for the channels of `performance.CHANNELS`."""
        points = self.bare_m.copy()
        points[self.larynx.vertices] += self.larynx.lift(state["larynx_mm"] / 1000, 1 + state["larynx_size"])
        for pull in self.pulls:
            if state[pull.muscle] > 1e-6:
                pull.apply(points, state[pull.muscle])
        motion.move_lips(points, self.lip_zone, self.fields, self.places, state)
        centre_z = self.places.mouth[2] - motion.ARCH_M
        rolls = state["upper_roll"], state["lower_roll"]
        lips.roll_lips(points, self.lip_zone, self.contact, self.fields, centre_z, rolls)
        motion.turn_jaw(points, self.jaw_zone, self.fields, self.places, state)
        self.contact.keep_apart(points)
        for lids in self.lids:
            lids.apply(points, state["blink"])
        gaze = motion.gaze_rotation(state["gaze_x"], state["gaze_y"])
        for eye, centre in zip(self.eyes, (self.places.eye_left, self.places.eye_right), strict=True):
            points[eye] = centre + (points[eye] - centre) @ gaze.T
        turn = np.array([state["turn_x"], state["turn_y"], state["turn_z"]])
        if turn.any():
            motion.bend_neck(points, self.fields.head, motion.neck_transforms(self.places, turn))
        return points
