"""The sine of the robot's heading in the map, in a file of its own."""

from __future__ import annotations

from pathlib import Path

from tests.channels.test_toy_kind import test_a_toy_kind_is_driven_verified_and_certified
from viatool.channels import kinds

NAME = "northing"
FILES = {
    "viatool/channels/NAME.py": '''\
"""How far the robot is turned to the north."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.channels.quantity import Quantity, observes
from viatool.channels.views import BoxView, View
from viatool.sets.forms import Forms


@observes("northing")
class Northing(Quantity):
    """The sine of the heading in the map: 1 to the north."""

    def measure(self, view: View) -> Floats:
        """See `Quantity.measure`."""
        return np.sin(view.poses[:, 2])

    def enclose(self, view: BoxView) -> Forms:
        """See `Quantity.enclose`."""
        theta = view.state("theta")
        spread = np.abs(theta.slope).sum(axis=1) + theta.rest
        slope = theta.slope * np.cos(theta.centre)[:, None]
        return Forms(np.sin(theta.centre), slope, 0.5 * np.square(spread) + theta.rest + 1e-12)
''',
    "viatool/channels/__init__.py": {
        "from viatool.channels.previous import": "from viatool.channels.northing import Northing as Northing\n"
        "from viatool.channels.previous import"
    },
}


def check(folder: Path) -> None:
    assert kinds()["northing"].__module__ == "viatool.channels.northing"
    test_a_toy_kind_is_driven_verified_and_certified(folder)
