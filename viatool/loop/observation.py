"""What the policy observes in one scenario: at poses, and over sets of states."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.channels import BoxView, Quantities, Sightings, View, see_precisely
from viatool.channels.erring import Erring
from viatool.channels.views import Eyes
from viatool.loop.told import NOTHING, Recollection, Told
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.motion.law import Kinematics
from viatool.rounding import SIGHT_ROUNDING
from viatool.safety.scene_poses import ScenePoses
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.sight.shapes import Shapes
from viatool.world import Scenes


@dataclass(frozen=True, eq=False)
class Sensors:
    """What the policy observes in one scenario.

    Parameters
    ----------
    quantities : Quantities
        In the order of the columns; n in all.
    shapes : Shapes
        What there is to be seen, for sets of poses.
    scenes : Scenes
        The same for poses; its only scene.
    goal : ndarray
        (2,) metres.
    dry : bool
        Whether poses whose footprint is clear keep the robot's origin out of all obstacles and on the map. Only such
        poses count then; else sensors may read there whatever they can.
    radii : ndarray or Erring, optional
        (n,) by how much each reading may be off, in the unit of its sensor, or how else; None for perfect sensors.
    kinematics : Kinematics
        Says what stands behind the poses of states: the command before, or the state of the motion.
    loose : ScenePoses, optional
        What may be anywhere around its place, alone; its poses are not used. None where nothing is.
    recollection : Recollection
        What is observed of the time that is left, and of the outputs of the step before.
    """

    quantities: Quantities
    shapes: Shapes
    scenes: Scenes
    goal: Floats
    dry: bool = False
    radii: Floats | Erring | None = None
    kinematics: Kinematics = DIFFERENTIAL
    loose: ScenePoses | None = None
    recollection: Recollection = field(default_factory=Recollection)

    def enclose(
        self, cells: StateBoxes, states: Forms | None = None, told: Told = NOTHING, *, jumps: int = 0
    ) -> Sightings:
        """Enclose what the network takes anywhere in sets of states, whatever the sensors err.

        Parameters
        ----------
        cells : StateBoxes
            C boxes.
        states : Forms, optional
            (C, 5) the sets within the boxes, in S symbols; by default all of the boxes, in five.
        told : Told
            What else is known of the sets.
        jumps : int
            Of how many readings of a LiDAR that jump, the sides are told apart.

        Returns
        -------
        Sightings
            (R, n), in the symbols of the states.

        Notes
        -----
        Sound: yes; rounding is counted.
        """
        states = cells.forms if states is None else states
        left, raw = self.recollection.over(told, cells, states)
        submerged = self._submerged(cells.poses)
        view = BoxView(cells, states, self.shapes, self.goal, submerged, left=left, raw=raw)
        return self.quantities.enclose(view, self.radii, jumps=jumps)

    def encode(self, readings: Floats) -> Floats:
        """Return what the network takes of readings (B, n), not yet rounded to its numbers."""
        return self.quantities.inputs.encode(readings)

    def measure(self, poses: Floats, previous: Floats, *, eyes: Eyes = see_precisely) -> Floats:
        """Return what the network takes of perfect sensors at poses (B, 3) after commands (B, 2), (B, n)."""
        return self.quantities.observe(self.read(poses, previous, eyes=eyes))

    def read(
        self,
        poses: Floats,
        previous: Floats,
        command: Floats | None = None,
        told: Told = NOTHING,
        *,
        believed: Floats | None = None,
        eyes: Eyes = see_precisely,
    ) -> Floats:
        """Return what perfect sensors read at poses (B, 3) after commands (B, A), (B, n) in float64 rays.

        Of a robot whose motion has a state, previous is that state (B, S); the command that led there may be given. The
        robots may believe other poses (B, 3), and share what they see with others.
        """
        scene = np.zeros(len(poses), np.int64)
        goals = np.broadcast_to(self.goal, (len(poses), 2))
        command, velocity = self.kinematics.recalled(previous, command)
        recalled = self.recollection.at(told, previous)
        view = View(
            self.scenes, poses, scene, goals, command, believed=believed, velocity=velocity, eyes=eyes,
            **recalled,
        )  # fmt: skip
        return self.quantities.read(view)

    def _submerged(self, boxes: PoseBoxes) -> Booleans:
        """Tell in which boxes the origin may be in an obstacle or off the map at a pose that counts, (C,)."""
        room = np.full(len(boxes), np.inf)
        if not self.dry:
            room = self.scenes.clearance(boxes.centre[:, :2], np.zeros(len(boxes), np.int64))
        if self.loose is not None:
            room = np.minimum(room, self.loose.throughout(boxes.centre).clearance(np.zeros(len(boxes)))[0])
        slack = SIGHT_ROUNDING * (self.shapes.scale + np.abs(boxes.centre).sum(axis=1))
        return np.asarray(~(room > boxes.extent + slack))
