"""TD7 (Fujimoto et al., 2023): TD3 with state-action embeddings, prioritised replay and checkpoints.

The constraint part is that of TD3: there is none. What TD7 changes of the backbone is in `viatool.train.td7`.
"""

from __future__ import annotations

from viatool.train.methods.td3 import Td3


class Td7(Td3):
    """Maximises the reward with a different learner; costs are recorded and ignored."""

    embedded = True
