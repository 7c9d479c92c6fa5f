"""What a network tells apart of what it observes: rays need not be followed beyond."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.channels import Quantities
from viatool.channels.erring import Erring
from viatool.policy import Policy
from viatool.policy.told_apart import ceilings
from viatool.rounding import SLIGHTLY_MORE
from viatool.setting.setting import Setting
from viatool.taylor.reach import Arithmetic, networks_of


def as_far_as_told_apart(
    observed: Quantities, policy: Policy, setting: Setting, errors: Erring, arithmetic: Arithmetic
) -> Quantities:
    """Return what a policy observes, with LiDARs that see no farther than its network tells apart.

    Parameters
    ----------
    observed : Quantities
        Of the present alone.
    policy : Policy
        With its network, and those that its runtime runs in that one's place.
    setting : Setting
        Says which rules around the policy observe the same.
    errors : Erring
        Of the readings.
    arithmetic : str
        For which networks it has to hold.

    Notes
    -----
    Sound: yes, for an error of a reading that grows by less than the reading does. Of a reading beyond the limit the
    least that the network takes of it is then no less than of the limit, and the most is the network's ceiling.
    """
    if setting.spec.overrides or observed.inputs.memory:
        return observed
    ceiling = np.max([ceilings(network) for network in networks_of(policy, arithmetic)], axis=0)
    return observed.up_to(_beyond(ceiling[: observed.columns[-1].stop], errors))


def _beyond(ceiling: Floats, errors: Erring) -> Floats:
    """Return from where on readings (m,) are at their ceiling in spite of their errors."""
    err = errors.absolute + np.abs(errors.common).sum(axis=0)
    share = np.where(errors.relative < 1.0, 1.0 - errors.relative, np.nan)
    limit = (ceiling + err + 1e-6 * (1.0 + ceiling)) / share * SLIGHTLY_MORE
    return np.where(np.isfinite(limit), limit, np.inf)
