"""How far every observation entry may be off, as it took effect: from the command line or from the specification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.policy import PolicySpecification
from viatool.setting.premises import Premise
from viatool.uncertainty import ErrorModel

Eps = float | Mapping[str, float] | None
_SPECIFICATION = "specification"
_MEMORY = "memory of the policy, as it was in each state"


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """The uncertainty of an observation.

    Parameters
    ----------
    radii : ndarray
        (n,) of every observation entry, in the unit of its channel.
    by_channel : dict
        Radius of each channel, by name; 0 for fixed ones.
    given : dict
        Radii of the command line by channel; the key ``""`` holds that of all others.
    sources : dict
        Who gave the radius of each channel.
    units : dict
        Of each channel.
    """

    radii: Floats
    by_channel: Mapping[str, float]
    given: Mapping[str, float]
    sources: Mapping[str, str]
    units: Mapping[str, str]

    @classmethod
    def of(cls, spec: PolicySpecification, eps: Eps, model: ErrorModel | None = None) -> SensorErrors:
        """Return what took effect.

        Parameters
        ----------
        spec : PolicySpecification
            n observation entries; may give radii itself.
        eps : float or mapping or None
            Radii of the command line: one, or by channel (``""``: all others).
        model : ErrorModel, optional
            Its absolute errors are radii as well.

        Raises
        ------
        ConfigurationError
            If a radius is out of range, missing, given twice, or of a channel that does not exist.
        """
        given = {} if eps is None else dict(eps) if isinstance(eps, Mapping) else {"": float(eps)}
        model = model or ErrorModel()
        stated = _absolute(model, spec, given)
        radii = spec.radii({**given, **stated})
        by_channel = {c.name: float(radii[spec.columns(c.name)][0]) for c in spec.observation}
        sources = {}
        for channel in spec.observation:
            if channel.value is not None:
                sources[channel.name] = f"fixed to {channel.value:g} by the specification"
            elif channel.name in stated:
                sources[channel.name] = model.source
            elif channel.kind == "memory" and channel.name not in given:
                sources[channel.name] = _MEMORY if channel.eps is None else _SPECIFICATION
            elif channel.name in given or "" in given:
                sources[channel.name] = "--eps"
            else:
                sources[channel.name] = _SPECIFICATION
        return cls(
            radii, by_channel, {**given, **stated}, sources, {c.name: c.unit for c in spec.observation}
        )

    def to_json(self) -> float | dict[str, float]:
        """Return the one radius that was given for everything, else what was given and what the specification added."""
        added = {
            name: self.by_channel[name] for name, source in self.sources.items() if source == _SPECIFICATION
        }
        if set(self.given) == {""} and not added:
            return self.given[""]
        return {**self.given, **added}

    def premises(self) -> tuple[Premise, ...]:
        """Return the radius of every channel and where it came from."""
        return tuple(
            Premise(f"eps of {name}", f"{radius:g} {self.units[name]}".rstrip(), self.sources[name])
            for name, radius in self.by_channel.items()
        )


def _absolute(model: ErrorModel, spec: PolicySpecification, given: Mapping[str, float]) -> dict[str, float]:
    """Return the radii that an error model states, by channel; refuse what contradicts --eps or names no channel."""
    stated = {}
    for name, terms in model.sensor.items():
        known = [channel.name for channel in spec.observation]
        if name not in known:
            raise ConfigurationError(
                f"{model.source}: sensor.{name}: there is no observation channel '{name}'",
                f"name one of {', '.join(known)}",
            )
        if terms.absolute is None:
            continue
        if given.get(name, terms.absolute) != terms.absolute:
            raise ConfigurationError(
                f"{model.source}: sensor.{name}.absolute is {terms.absolute:g}, --eps {name}={given[name]:g} "
                "contradicts it",
                "leave one of them out",
            )
        stated[name] = terms.absolute
    return stated
