"""Where a goal is seen from anywhere in boxes of poses, as linear forms of the pose.

The bearing psi of a goal at w from the robot turns by ``(w x D) / |w|^2`` to first order when the robot moves by
D, with a second-order rest of at most ``rho^2 / (2 (|w| - rho)^2)``, as the Hessian of the bearing has the norm
1 / distance^2. Its cosine and sine follow by Taylor's theorem, as does the distance, whose Hessian lies between 0
and 1 / distance. In the robot's frame the goal is at ``e^(-i theta) w``, which a pose that is D away and turned by
delta changes by ``-e^(-i theta) D - i delta e^(-i theta) w`` up to ``|w| delta^2 / 2 + |D| |delta|``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Plane
from viatool.motion.arcs import wrap_angle
from viatool.rounding import SIGHT_ROUNDING
from viatool.sets.forms import Forms, PoseBoxes


@dataclass(frozen=True, eq=False)
class GoalForms:
    """A goal in the robot's frame, as forms (C, 1) each.

    Distance, x and y are in metres. The bearing is in radians and not wrapped: it continues beyond a half turn.
    """

    distance: Forms
    bearing: Forms
    cosine: Forms
    sine: Forms
    x: Forms
    y: Forms

    @classmethod
    def seen_from(cls, boxes: PoseBoxes, goal: Floats, scale: float) -> GoalForms:
        """Enclose a goal (2,) as seen from boxes of poses, on a map whose coordinates are below a scale.

        Notes
        -----
        Sound: yes, by the derivation of the module; rounding is counted.
        """
        away = (goal[0] + 1j * goal[1]) - boxes.places
        distance, reach = np.abs(away), boxes.extent
        slack = SIGHT_ROUNDING * (scale + distance + np.abs(boxes.centre).sum(axis=1))
        least = distance - reach
        seen = least > np.maximum(reach, 1e-3)  # the goal is well outside of the box
        safe, inner = np.where(seen, distance, 1.0), np.where(seen, least, 1.0)
        unit = away / safe
        far = _form([-unit.real, -unit.imag, 0.0 * safe], boxes, distance)
        far.rest[:] = (0.5 * np.square(reach) / inner + slack)[:, None]
        bearing = wrap_angle(np.angle(away) - boxes.centre[:, 2])
        slope = _form([unit.imag / safe, -unit.real / safe, -np.ones_like(safe)], boxes, bearing)
        rest = 0.5 * np.square(reach / inner) + slack / inner
        turn = np.abs(slope.slope[:, :, 0]).sum(axis=1) + rest

        def part(value: Floats, derivative: Floats) -> Forms:
            left_out = np.abs(derivative) * rest + 0.5 * np.square(turn) + slack
            form = Forms(value[:, None], slope.slope * derivative[:, None, None], left_out[:, None])
            one = np.ones((len(boxes), 1))
            return Forms.choose(seen, form, Forms.between(-one, one))

        anywhere = np.full((len(boxes), 1), np.pi)
        turned = Forms(slope.centre, slope.slope, rest[:, None].copy())
        whole = Forms.between((np.maximum(least, 0.0) - slack)[:, None], (distance + reach + slack)[:, None])
        return cls(
            Forms.choose(seen, far, whole),
            Forms.choose(seen, turned, Forms.between(-anywhere, anywhere)),
            part(np.cos(bearing), -np.sin(bearing)),
            part(np.sin(bearing), np.cos(bearing)),
            *_in_frame(boxes, away, slack),
        )


def _in_frame(boxes: PoseBoxes, away: Plane, slack: Floats) -> tuple[Forms, Forms]:
    """Return x and y of a point that is `away` from the middles of boxes, in the robot's frame."""
    theta, turn = boxes.centre[:, 2], boxes.turn
    ahead = np.exp(-1j * theta) * away
    cosine, sine = np.cos(theta), np.sin(theta)
    x = _form([-cosine, -sine, ahead.imag], boxes, ahead.real)
    y = _form([sine, -cosine, -ahead.real], boxes, ahead.imag)
    rest = 0.5 * np.abs(away) * np.square(turn) + boxes.extent * turn + slack
    for form in (x, y):
        form.rest[:] = rest[:, None]
    return x, y


def _form(gradient: list[Floats], boxes: PoseBoxes, value: Floats) -> Forms:
    """Return the linear form of one quantity, with no rest yet."""
    slope = np.stack(gradient, axis=1) * boxes.radius
    return Forms(value[:, None].copy(), slope[:, :, None], np.zeros((len(boxes), 1)))
