"""Whole missions: from a box of starts to the goal, whatever the sensors err."""

from viatool.missions.follow import MissionLimits
from viatool.missions.job import mission
from viatool.missions.verdicts import MISSION_VERDICTS, Mission, Missions

__all__ = ["MISSION_VERDICTS", "Mission", "MissionLimits", "Missions", "mission"]
