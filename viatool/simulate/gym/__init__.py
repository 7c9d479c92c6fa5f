"""Gymnasium environments. Importing this module registers ``viatool/Navigation-v0``.

>>> import gymnasium
>>> environment = gymnasium.make("viatool.simulate.gym:viatool/Navigation-v0", map="maps/lab.yaml")

does both at once. gymnasium is in the extras `sim` and `train`.
"""

from __future__ import annotations

import gymnasium

from viatool.simulate.gym.environment import NavigationEnvironment
from viatool.simulate.gym.vector import NavigationVectorEnvironment

__all__ = ["ID", "NavigationEnvironment", "NavigationVectorEnvironment"]

ID = "viatool/Navigation-v0"
"""What `gymnasium.make` and `gymnasium.make_vec` know the environment by."""

if ID not in gymnasium.registry:
    gymnasium.register(
        ID,
        entry_point="viatool.simulate.gym.environment:NavigationEnvironment",
        vector_entry_point="viatool.simulate.gym.vector:NavigationVectorEnvironment",
        order_enforce=True,
    )
