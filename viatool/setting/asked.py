"""What every outcome says of the setting that it answers."""

from __future__ import annotations

from viatool.setting.premises import Premise
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.world import WorldMap


class Asked:
    """An outcome of something that was asked of a policy: its parts that are those of the setting.

    Attributes
    ----------
    setting : Setting
        What was asked, as it took effect.
    """

    setting: Setting

    @property
    def world_map(self) -> WorldMap:
        """Return the map, with the robot and the clearances that counted."""
        return self.setting.world_map

    @property
    def rules(self) -> Rules:
        """Return what had to hold."""
        return self.setting.rules

    @property
    def eps(self) -> float | dict[str, float]:
        """Return the radius that was given for everything, else radii by channel, as they took effect."""
        return self.setting.errors.to_json()

    @property
    def premises(self) -> tuple[Premise, ...]:
        """Return everything that took effect, and who said so."""
        return self.setting.premises
