"""What a LaserScan message says of a LiDAR, taken into a proposal: directions, order and ranges of its rays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from viatool.channels import kinds
from viatool.errors import PolicyError
from viatool.proposals.layout import Channel, size_of
from viatool.proposals.proposal import Guess, Proposal
from viatool.proposals.rays import tail

_TAILS = (5, 4, 3, 2)
_DIGITS = 9
_STATED = "range_max"
"""Where a guess is checked that came from the limits of the observation."""
_UNITS = {
    "lidar": "m",
    "goal_distance": "m",
    "goal_bearing": "rad",
    "goal_x": "m",
    "goal_y": "m",
    "linear_velocity": "m/s",
    "angular_velocity": "rad/s",
    "previous_linear": "m/s",
    "previous_angular": "rad/s",
}


@dataclass(frozen=True)
class Scanner:
    """The geometry of a laser scan, as a sensor_msgs/LaserScan has it.

    Parameters
    ----------
    first, step : float
        Direction of the first ray and the angle to the next, in radians, counter-clockwise in the sensor's frame; a
        negative step goes clockwise.
    rays : int
        How many there are.
    least, most : float
        Range in metres.
    frame : str
        Of the sensor.
    ranges : tuple of float
        What was read, in metres; empty where the message was cut.
    """

    first: float
    step: float
    rays: int
    least: float
    most: float
    frame: str = ""
    ranges: tuple[float, ...] = ()

    def lidar(self, bins: int, yaw: float = 0.0) -> tuple[dict[str, Any], str]:
        """Return the LiDAR of a channel of so many numbers as a specification has it, and what was guessed about it.

        Parameters
        ----------
        bins : int
            Numbers that the policy takes.
        yaw : float
            Heading of the sensor on the robot, in radians.
        """
        rays, step, guess = self.rays, abs(self.step), ""
        if rays % bins:
            around = rays * step > 2.0 * math.pi - 1.5 * step
            step *= rays / bins if around else (rays - 1) / max(bins - 1, 1)
            guess = f"the policy takes {bins} rays, evenly spread over the {rays} of the scan"
            rays = bins
        elif rays > bins:
            guess = f"each number is the least of {rays // bins} consecutive rays of the {rays} of the scan"
        order = {"order": "clockwise"} if self.step < 0.0 else {}
        return {
            "start": round(self.first + yaw, _DIGITS),
            "step": round(step, _DIGITS),
            "rays": rays,
            "bins": bins,
            **order,
            "minimum_range": round(self.least, _DIGITS),
            "maximum_range": round(self.most, _DIGITS),
        }, guess


def with_scanner(proposal: Proposal, scanner: Scanner, yaw: float = 0.0) -> Proposal:
    """Take what a scan says into a proposal.

    Parameters
    ----------
    proposal : Proposal
        Its LiDAR gets the rays of the scan; where nothing is known of the observation, rays of the scan and what
        commonly follows them are looked for in its size.
    scanner : Scanner
        The scan.
    yaw : float
        Heading of the sensor on the robot, in radians.
    """
    sizes = [channel.get("size") for channel in proposal.observation if channel["kind"] == "lidar"]
    if not sizes or (proposal.source.startswith("its sizes") and scanner.rays not in sizes):
        proposal = _laid_out(proposal, scanner, exact=bool(sizes))
    stated = any(guess.check == _STATED for guess in proposal.guesses)
    guesses = [guess for guess in proposal.guesses if not guess.check.startswith(("angle_min", _STATED))]
    channels = []
    for channel in proposal.observation:
        if channel["kind"] == "lidar":
            lidar, guess = scanner.lidar(int(channel.get("size", channel["lidar"]["rays"])), yaw)
            before = channel["lidar"].get("maximum_range") if stated else None
            channel = {**channel, "size": lidar["bins"], "lidar": lidar}
            guesses += [Guess(guess, "what the environment makes of a scan")] if guess else []
            if before == 1.0 < scanner.most:
                channel["scale"] = round(1.0 / scanner.most, _DIGITS)
                guesses.append(Guess(f"readings are shares of {scanner.most:g} m", "the scaling of the scan"))
            elif before is not None and scanner.least < before < scanner.most:
                lidar["maximum_range"] = before
                guesses.append(
                    Guess(f"readings are cut at {before:g} m, as the observation's limits say", _STATED)
                )
        channels.append(channel)
    return replace(
        proposal, observation=channels, guesses=tuple(guesses), source=f"{proposal.source}, and a scan"
    )


def _laid_out(proposal: Proposal, scanner: Scanner, *, exact: bool) -> Proposal:
    """Return a proposal with rays of a scan, all of them if `exact`, and what commonly follows; else as it was."""
    more = dict(proposal.more or {})
    inputs = sum(map(size_of, proposal.observation)) * int(more.pop("frames", {}).get("count", 1))
    for count in sorted(_TAILS, key=lambda count: (inputs - count != scanner.rays, -count)):
        bins, rest = inputs - count, tail(count)
        if rest is not None and bins > 1 and (bins == scanner.rays or not (exact or scanner.rays % bins)):
            names = ", ".join(channel["name"] for channel in rest)
            guess = Guess(
                f"{inputs} = {bins} readings + {count}: first the LiDAR, then {names}",
                "where the observation is put together",
                meaning=True,
            )
            lidar = {"name": "lidar", "kind": "lidar", "size": bins, "unit": "m", "lidar": {"rays": bins}}
            return replace(
                proposal,
                observation=[lidar, *rest],
                source=f"its sizes, {inputs} numbers in",
                guesses=(guess, *(other for other in proposal.guesses if not other.meaning)),
                more=more,
            )
    return proposal


def with_kinds(proposal: Proposal, names: Sequence[str], outputs: Sequence[str]) -> Proposal:
    """Return a proposal whose observation and commands are of these kinds, in this order, as somebody said.

    Parameters
    ----------
    proposal : Proposal
        Has the sizes.
    names : sequence of str
        Kinds of observations, each of one number; a ``lidar`` has what is left. None leaves the observation as it is.
    outputs : sequence of str
        Kinds of the commands; none leaves them as they are.

    Raises
    ------
    PolicyError
        If there is no such kind, or the sizes do not add up.
    """
    if unknown := [name for name in names if name not in kinds()]:
        raise PolicyError(f"'{unknown[0]}' is no kind of observation", f"choose among {', '.join(kinds())}")
    channels = _channels(names, proposal) if names else proposal.observation
    actions = proposal.action
    if outputs:
        if len(outputs) != len(actions):
            raise PolicyError(
                f"the policy gives {len(actions)} numbers, and {', '.join(outputs)} are {len(outputs)}",
                "name each",
            )
        units = {"linear": "m/s", "lateral": "m/s", "angular": "rad/s", "steering": "rad"}
        actions = [
            {**action, "name": kind, "kind": kind, "unit": units.get(kind, action.get("unit", ""))}
            for action, kind in zip(actions, outputs, strict=True)
        ]
    kept = tuple(
        guess
        for guess in proposal.guesses
        if not (names and guess.meaning)
        and not (outputs and guess.what.startswith(("the outputs command", "each action")))
    )
    return replace(proposal, observation=channels, action=actions, guesses=kept)


def _channels(names: Sequence[str], proposal: Proposal) -> list[Channel]:
    inputs = sum(map(size_of, proposal.observation))
    before = {str(channel["kind"]): channel for channel in proposal.observation}
    sizes = {name: len(proposal.action) if name == "previous_raw" else 1 for name in names}
    if "lidar" in sizes:
        sizes["lidar"] = inputs - sum(sizes[name] for name in names if name != "lidar")
    if names.count("lidar") > 1 or sum(sizes[name] for name in names) != inputs or min(sizes.values()) < 1:
        raise PolicyError(
            f"the policy takes {inputs} numbers, and {', '.join(names)} are "
            f"{sum(sizes[name] for name in names if name != 'lidar')} beside a LiDAR",
            "name what each number is, in their order",
        )
    found = []
    for number, name in enumerate(names):
        label = name if names.index(name) == number else f"{name}_{number}"
        channel = {"name": label, "kind": name, "size": sizes[name], "unit": _UNITS.get(name, "")}
        known = before.get("lidar", {}).get("lidar", {})
        lidar = {"field_of_view": round(math.pi, _DIGITS), "maximum_range": 10.0, **known}
        if name == "lidar":
            lidar = (
                lidar
                if known.get("bins", known.get("rays")) == sizes[name]
                else {**lidar, "rays": sizes[name]}
            )
            lidar.pop("bins", None) if lidar["rays"] == sizes[name] else None
        found.append({**channel, **({"lidar": lidar} if name == "lidar" else {})})
    return found
