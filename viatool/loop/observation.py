"""What a robot may observe anywhere in a box of poses: every column as a linear form of the pose.

The bearing psi of a goal at w from the robot turns by ``(w x D) / |w|^2`` to first order when the robot moves by
D, with a second-order rest of at most ``rho^2 / (2 (|w| - rho)^2)``, as the Hessian of the bearing has the norm
1 / distance^2. Its cosine and sine follow by Taylor's theorem, as does the distance, whose Hessian lies between 0
and 1 / distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.policy import ObservationChannel
from viatool.rounding import SIGHT_ROUNDING
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.sight.scan import enclose_scan
from viatool.sight.shapes import Shapes
from viatool.world import Lidar


@dataclass(frozen=True, eq=False)
class Sensors:
    """What the policy observes in one situation.

    Parameters
    ----------
    channels : sequence of ObservationChannel
        In the order of the columns; n in all.
    lidar : Lidar
        As the policy's specification describes it.
    shapes : Shapes
        What there is to be seen.
    goal : ndarray
        (2,) metres.
    """

    channels: Sequence[ObservationChannel]
    lidar: Lidar
    shapes: Shapes
    goal: Floats

    def enclose(self, cells: StateBoxes) -> Forms:
        """Enclose what perfect sensors read anywhere in cells.

        Parameters
        ----------
        cells : StateBoxes
            C cells.

        Returns
        -------
        Forms
            (C, n).

        Notes
        -----
        Sound: yes; rounding is counted.
        """
        goals = self._goal_forms(cells.poses)
        parts = []
        for channel in self.channels:
            if channel.value is not None:
                fixed = np.full((len(cells), channel.size), channel.value)
                parts.append(Forms.between(fixed, fixed))
            elif channel.kind == "lidar":
                parts.append(enclose_scan(cells.poses, self.shapes, self.lidar))
            elif channel.kind in goals:
                parts.append(goals[channel.kind])
            else:
                column = [0] if channel.kind == "previous_linear" else [1]
                parts.append(Forms.between(cells.previous_lower[:, column], cells.previous_upper[:, column]))
        return Forms(
            np.concatenate([part.centre for part in parts], axis=1),
            np.concatenate([part.slope for part in parts], axis=2),
            np.concatenate([part.rest for part in parts], axis=1),
        ).checked()

    def _goal_forms(self, boxes: PoseBoxes) -> dict[str, Forms]:
        """Return the forms (C, 1) of the channels that see the goal."""
        away = (self.goal[0] + 1j * self.goal[1]) - boxes.places
        distance, reach = np.abs(away), boxes.extent
        slack = SIGHT_ROUNDING * (self.shapes.scale + distance + np.abs(boxes.centre).sum(axis=1))
        least = distance - reach
        seen = least > np.maximum(reach, 1e-3)  # the goal is well outside of the box
        safe, inner = np.where(seen, distance, 1.0), np.where(seen, least, 1.0)
        unit = away / safe
        far = _form([-unit.real, -unit.imag, 0.0 * safe], boxes, distance)
        far.rest[:] = (0.5 * np.square(reach) / inner + slack)[:, None]
        bearing = np.angle(away) - boxes.centre[:, 2]
        slope = _form([unit.imag / safe, -unit.real / safe, -np.ones_like(safe)], boxes, bearing)
        rest = 0.5 * np.square(reach / inner) + slack / inner
        turn = np.abs(slope.slope[:, :, 0]).sum(axis=1) + rest
        forms = {"goal_distance": far}
        for kind, value, derivative in (
            ("goal_cosine", np.cos(bearing), -np.sin(bearing)),
            ("goal_sine", np.sin(bearing), np.cos(bearing)),
        ):
            left_out = np.abs(derivative) * rest + 0.5 * np.square(turn) + slack
            forms[kind] = Forms(value[:, None], slope.slope * derivative[:, None, None], left_out[:, None])
        whole = {"goal_distance": (np.maximum(least, 0.0) - slack, distance + reach + slack)}
        one = np.ones_like(distance)
        return {
            kind: _where(seen, form, Forms.between(*(end[:, None] for end in whole.get(kind, (-one, one)))))
            for kind, form in forms.items()
        }


def _form(gradient: list[Floats], boxes: PoseBoxes, value: Floats) -> Forms:
    """Return the linear form of one quantity, with no rest yet."""
    slope = np.stack(gradient, axis=1) * boxes.radius
    return Forms(value[:, None].copy(), slope[:, :, None], np.zeros((len(boxes), 1)))


def _where(holds: Booleans, form: Forms, other: Forms) -> Forms:
    """Return one form or the other for each box."""
    return Forms(
        np.where(holds[:, None], form.centre, other.centre),
        np.where(holds[:, None, None], form.slope, other.slope),
        np.where(holds[:, None], form.rest, other.rest),
    )
