"""What varies, put together and checked: all readings, those of some channels, or a term of the error model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.margins.varying import Varying, VaryingReadings, VaryingTerm
from viatool.policy import Policy
from viatool.setting.premises import Premise
from viatool.setting.sensor_errors import Eps, SensorErrors
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel
from viatool.verification.examination import StateExamination
from viatool.world import Scenario, WorldMap


@dataclass(frozen=True)
class Varied:
    """What varies, for people and reports.

    Parameters
    ----------
    kind : str
        "channels" or "term".
    proportions : mapping
        What varies, by name, and by how much for each unit of the error: 1 but for channels that err by less.
    unit : str
        Of the error; empty where channels have different ones.
    most, resolution : float
        The largest error that is tried, and how close both ends are followed.
    """

    kind: str
    proportions: Mapping[str, float]
    unit: str
    most: float
    resolution: float

    @property
    def words(self) -> str:
        """Return in words what varies, and how far."""
        unit = self.unit or "in the unit of each"
        named = [
            name if share == 1.0 else f"{name} (times {share:.3g})"
            for name, share in self.proportions.items()
        ]
        return f"{', '.join(named)}: 0 to {self.most:g} {unit}".rstrip()

    def to_json(self) -> dict[str, Any]:
        """Return plain data for a report."""
        return {
            "kind": self.kind,
            "proportions": dict(self.proportions),
            "unit": self.unit,
            "most": self.most,
            "resolution": self.resolution,
        }


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked of every state, at every error.

    Parameters
    ----------
    setting : Setting
        What is asked at no error of what varies: states are driven and recorded in it.
    widest : Setting
        What is asked at the largest error, but for the radii of readings.
    varying : Varying
        What is asked at each error.
    varied : Varied
        The same in words.
    """

    setting: Setting
    widest: Setting
    varying: Varying
    varied: Varied

    @property
    def premises(self) -> tuple[Premise, ...]:
        """Return everything that took effect; of what varies, how far it does."""
        varied, told = self.varied, []
        place = "eps of {}" if varied.kind == "channels" else "{}"
        names = {place.format(name): share for name, share in varied.proportions.items()}
        for premise in self.setting.premises:
            if premise.name in names:
                unit = premise.value.partition(" ")[2]
                value = f"0 to {names[premise.name] * varied.most:g} {unit}".rstrip()
                premise = Premise(premise.name, value, "varied")
            told.append(premise)
        return tuple(told)


@dataclass(frozen=True, eq=False)
class Inquiry:
    """What a user asks for, before it is checked.

    Parameters
    ----------
    eps : float or mapping or None
        Proportions of the radii of all channels; or, where channels or a term are named, what the others stay at.
    wishes : Wishes
        What counts instead of what policy and map say.
    scenarios : sequence of Scenario, optional
        What is asked about.
    channels : sequence of str
        Channels whose readings err more and more; none means all.
    term : str, optional
        A term of the error model instead.
    most, resolution : float
        The largest error that is tried, and how close both ends are followed.
    engine : mapping
        Settings of `viatool.reach`.
    seed : int
        Of the search for counterexamples.
    """

    eps: Eps
    wishes: Wishes
    scenarios: Sequence[Scenario] | None
    channels: Sequence[str]
    term: str | None
    most: float
    resolution: float
    engine: Mapping[str, Any]
    seed: int

    def of(self, policy: Policy, world_map: WorldMap) -> Question:
        """Put together what is asked of a policy on a map.

        Raises
        ------
        PolicyError, ConfigurationError
            As `Setting.of`; if nothing is left to vary, or what is named cannot.
        """
        if not 0.0 < self.most < np.inf:
            raise ConfigurationError(
                f"the largest error that is tried is {self.most:g}",
                "give a positive number to --most, such as 0.5",
            )
        if not self.most * 2.0**-24 < self.resolution <= self.most:
            raise ConfigurationError(
                f"the resolution is {self.resolution:g}, expected more than a 16-millionth of the largest error, "
                f"{self.most:g}, and no more than that",
                "leave --resolution out for a 256th of the largest error",
            )
        if self.term is None:
            return self._of_readings(policy, world_map)
        if self.channels:
            raise ConfigurationError(
                f"channel {self.channels[0]} and term {self.term} cannot vary at once",
                "leave one of them out",
            )
        return self._of_term(self.term, policy, world_map)

    def _of_readings(self, policy: Policy, world_map: WorldMap) -> Question:
        model = self.wishes.errors
        stays = _stays(self.eps, self.channels, model)
        names = self.channels or tuple(model.sensor)
        wishes = self.wishes
        for name in names:
            wishes = replace(wishes, errors=wishes.errors.without(f"sensor.{name}.absolute"))
        setting = Setting.of(policy, world_map, stays, wishes, self.scenarios, job="verify")
        direction = self._direction(setting)
        examination = StateExamination.of(
            setting.commanding(policy), setting, self.engine, only_contested=True, seed=self.seed
        )
        spec = setting.spec
        shares = {one.name: float(direction[spec.columns(one.name)][0]) for one in spec.observation}
        units = {one.unit for one in spec.observation if shares[one.name] > 0.0}
        varied = self._varied(
            "channels", {name: share for name, share in shares.items() if share > 0.0}, units
        )
        varying = VaryingReadings(examination, setting.radii, direction)
        return Question(setting, setting, varying, varied)

    def _direction(self, setting: Setting) -> Floats:
        """Return by how much the radius of each entry grows with the error, (n,); the largest is 1."""
        spec, model = setting.spec, self.wishes.errors
        if self.channels:
            for name in self.channels:
                value = spec.channel(name).value
                if value is not None:
                    raise ConfigurationError(
                        f"channel '{name}' is fixed to {value:g} by the specification and has no error",
                        "name another channel",
                    )
            return spec.radii({"": 0.0, **dict.fromkeys(self.channels, 1.0)})
        stated = any(terms.absolute is not None for terms in model.sensor.values())
        radii = (
            spec.radii(1.0)
            if self.eps is None and not stated
            else SensorErrors.of(spec, self.eps, model).radii
        )
        radii = radii if radii.any() else spec.radii(1.0)  # of nothing there are no proportions
        if not radii.any():
            raise ConfigurationError(
                "the specification fixes every channel, so no reading errs",
                "name a term of an error model with --term",
            )
        return np.asarray(radii / radii.max())

    def _of_term(self, place: str, policy: Policy, world_map: WorldMap) -> Question:
        stays: Eps = {"": 0.0} if self.eps is None else self.eps
        model = self.wishes.errors
        model.at(place, self.most)  # refuses what cannot vary, or not so far
        setting = Setting.of(policy, world_map, stays, self.wishes, self.scenarios, job="verify")
        bare = setting.bare().world_map
        varying = VaryingTerm(policy, bare, stays, self.wishes, place, self.engine, self.seed)
        unit = next(unit for where, _, _, unit in model.stated() if where == place)
        varied = self._varied("term", {place: 1.0}, {unit})
        return Question(setting, varying.setting(self.most), varying, varied)

    def _varied(self, kind: str, proportions: Mapping[str, float], units: set[str]) -> Varied:
        return Varied(kind, proportions, units.pop() if len(units) == 1 else "", self.most, self.resolution)


def _stays(eps: Eps, channels: Sequence[str], model: ErrorModel) -> dict[str, float]:
    """Return the radii that stay while channels vary; none do where all vary."""
    if not channels:
        return {"": 0.0}
    given = {} if eps is None else dict(eps) if isinstance(eps, Mapping) else {"": float(eps)}
    return {"": 0.0, **given, **dict.fromkeys(channels, 0.0)}
