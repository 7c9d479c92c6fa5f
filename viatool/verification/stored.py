"""A result as arrays and back: what the state table holds besides its columns, so that every report can be made of it.

What is read back is for showing alone: nothing is proved again, and nothing new can be proved of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.loop.horizon import Crashes, Horizon, Tubes
from viatool.policy import PolicySpecification
from viatool.safety.counterexamples import Witnesses
from viatool.safety.reasons import Reason, Reasons
from viatool.setting.premises import Premise
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.taylor import ReachableSet
from viatool.trajectory import Trajectory, read_scenario, write_scenario
from viatool.uncertainty import ErrorModel
from viatool.verification.findings import StateFindings
from viatool.verification.result import Result
from viatool.verification.rules_document import read_rules, rules_document
from viatool.world import WorldMap

Arrays = Mapping[str, NDArray[Any]]

_FOUND = {"witnesses": Witnesses, "tubes": Tubes, "crashes": Crashes}
_TRAJECTORY = ("connected", "from_rest", "clocked", "began", "notes")


def asked_of(result: Result) -> dict[str, Any]:
    """Return what was asked as plain data, as far as reports speak of it."""
    setting, grid = result.setting, result.world_map.obstacles.grid
    robots = [one.value for one in setting.premises if one.name == "robot" and one.source == "--robot"]
    return {
        "specification": setting.spec.model_dump(mode="json", by_alias=True, exclude_none=True),
        "rules": rules_document(setting.rules),
        "errors": setting.uncertainty.model_dump(mode="json", by_alias=True, exclude_none=True),
        "errors_source": setting.uncertainty.source,
        "robot": robots[0] if robots else None,
        "unknown": None if grid is None else ("free" if grid.unknown_is_free else "obstacle"),
        "horizon": None if result.horizon is None else asdict(result.horizon.horizon),
        "bounded_every": result.bounded_every,
        "origin": result.origin,
        "trajectory": _about(result),
        "close_trajectory": None if result.close is None else _about(result.close),
    }


def _about(result: Result) -> dict[str, Any]:
    """Return what its trajectory has besides arrays."""
    return {name: getattr(result.trajectory, name) for name in _TRAJECTORY}


def stored_arrays(result: Result) -> dict[str, NDArray[Any]]:
    """Return what the state table lacks of a result, by name; of close places behind ``close.``."""
    trajectory = result.trajectory
    found = StateFindings(
        result.reachable,
        result.contested,
        result.judgement,
        result.witnesses,
        {},
        *(() if result.horizon is None else (result.horizon.tubes, result.horizon.crashes)),
    ).to_arrays()
    arrays = {
        "time": trajectory.time,
        "cost": trajectory.costs,
        "scenario": np.array([write_scenario(one) for one in trajectory.scenarios], dtype=np.str_),
        "under_way": result.under_way,
        "begun": result.begun,
        "contested.danger": result.contested.danger,
        **({} if result.velocity is None else {"velocity": result.velocity}),
        **{name: array for name, array in found.items() if name.partition(".")[0] in _FOUND},
    }
    if result.close is not None:
        arrays |= {f"close.{name}": array for name, array in stored_arrays(result.close).items()}
    return arrays


def read_result(
    report: Mapping[str, Any], asked: Mapping[str, Any], table: Arrays, more: Arrays, world_map: WorldMap
) -> Result:
    """Return a result as it was, of what reports show.

    Parameters
    ----------
    report : mapping
        The report JSON.
    asked : mapping
        As `asked_of` returns it.
    table, more : mapping
        The arrays of the state table, and those of `stored_arrays`.
    world_map : WorldMap
        The map of the report.

    Raises
    ------
    KeyError, IndexError, ValueError, TypeError
        If something is missing or of another form, or the table has not what the report tells.
    ViatoolError
        If what was asked does not fit the map.
    """
    setting = _setting(report, asked, world_map)
    driven = _result(report, asked, setting, table, more, report.get("reasons", ()))
    if "close_pose" not in table:
        return _as_told(driven, report)
    close = _result(
        report,
        {**asked, "horizon": None, "trajectory": asked["close_trajectory"]},
        setting,
        {name.removeprefix("close_"): array for name, array in table.items() if name.startswith("close_")},
        {name.removeprefix("close."): array for name, array in more.items() if name.startswith("close.")},
        report["close"].get("reasons", ()),
    )
    return _as_told(replace(driven, close=close), report)


_COUNTED = ("states", "verdicts", "stake", "safety_rate", "danger_rate", "contested_rate", "close_rate")


def _as_told(result: Result, report: Mapping[str, Any]) -> Result:
    """Return a result whose table has what its report tells.

    Raises
    ------
    ValueError
        If a count differs.
    """
    found = result.to_json()
    for name in _COUNTED:
        if found.get(name) != report.get(name):
            raise ValueError(f"the table gives {name} {found.get(name)}, its report {report.get(name)}")
    return result


def _setting(report: Mapping[str, Any], asked: Mapping[str, Any], world_map: WorldMap) -> Setting:
    rules = read_rules(asked["rules"])
    errors = ErrorModel.model_validate(asked["errors"]).model_copy(update={"source": asked["errors_source"]})
    wishes = Wishes(
        criterion=rules.criterion,
        clearance=rules.clearance.collision,
        danger=rules.clearance.danger,
        interval=rules.interval,
        footprint=rules.footprint,
        delay=rules.delay if errors.timing.delay is None else 0.0,
        deceleration=rules.deceleration,
        robot=asked["robot"],
        prefer={"": "map"},
        errors=errors,
    )
    setting = Setting.of_specification(
        PolicySpecification.model_validate(asked["specification"]),
        world_map,
        report["eps"],
        wishes,
        (),
        job="verify" if asked["horizon"] is None else "verify with a horizon",
    )
    premises = tuple(Premise(**premise) for premise in report["premises"])
    return replace(setting, rules=rules, premises=premises)


def _result(
    report: Mapping[str, Any],
    asked: Mapping[str, Any],
    setting: Setting,
    table: Arrays,
    more: Arrays,
    reasons: Any,
) -> Result:
    """Return the result of driven states, or of close places."""
    found = StateFindings.from_arrays(
        {
            **_reachable(table),
            "contested.collision": table["contested"],
            "contested.danger": more["contested.danger"],
            "judgement.safe": table["verdict"] == "safe",
            "judgement.danger": table["danger"],
            "judgement.sampled": table["sampled"],
            **{name: array for name, array in more.items() if name.partition(".")[0] in _FOUND},
        }
    )
    count = len(table["pose"])
    return Result(
        policy_path=Path(report["policy"]["path"]),
        policy_sha256=report["policy"]["sha256"],
        setting=setting,
        trajectory=Trajectory(
            poses=table["pose"],
            observations=table["observation"],
            actions=np.zeros((count, 0)),
            episode=table["episode"],
            time=more["time"],
            outcomes=table["outcome"],
            costs=more["cost"],
            scenarios=tuple(read_scenario(str(text)) for text in more["scenario"]),
            people=table.get("people", np.zeros((count, 0, 5))),
            **{**asked["trajectory"], "notes": tuple(asked["trajectory"]["notes"])},
        ),
        arithmetic=report["arithmetic"],
        engine=report["engine"],
        under_way=more["under_way"],
        begun=more["begun"],
        velocity=more.get("velocity"),
        reachable=found.reachable,
        contested=found.contested,
        judgement=found.judgement,
        witnesses=found.witnesses,
        seconds=report["seconds"],
        versions=report["versions"],
        origin=asked["origin"],
        horizon=found.over(None if asked["horizon"] is None else Horizon(**asked["horizon"])),
        reasons=Reasons(tuple(map(_told, reasons)), len(reasons)),
        bounded_every=asked["bounded_every"],
        unjudged=report.get("not_judged", {}),
    )


def _reachable(table: Arrays) -> dict[str, NDArray[Any]]:
    """Return bounds as findings name them; what was attained within them is not kept, and NaN."""
    known: dict[str, NDArray[Any]] = {
        name: table[name] for name in ("lower", "upper", "possible") if name in table
    }
    nothing = np.full(table["lower"].shape, np.nan)
    left = {field.name: nothing for field in fields(ReachableSet) if field.name in _NOT_KEPT}
    return {f"reachable.{name}": array for name, array in {**left, **known}.items()}


_NOT_KEPT = ("attained_lower", "attained_upper", "deviation")


@dataclass(frozen=True)
class ToldReason(Reason):
    """A reason as a report told it."""

    told: Mapping[str, Any]

    @property
    def brief(self) -> str:
        """Return what the report says in one line."""
        return str(self.told["brief"])

    @property
    def words(self) -> str:
        """Return what the report says in sentences."""
        return str(self.told["words"])

    def to_json(self) -> dict[str, Any]:
        """Return the reason as the report has it."""
        return dict(self.told)


def _told(record: Mapping[str, Any]) -> ToldReason:
    """Return a reason of the report: its words stand, and of its parts those that were kept."""
    known: dict[str, Any] = {field.name: record.get(field.name) for field in fields(Reason)}
    known |= {name: _box(record[name]) for name in ("bound", "attained")}
    return ToldReason(**{**known, "of_sensors": False, "actions": ()}, told=record)


def _box(ends: Mapping[str, Any] | None) -> Floats:
    return np.full((2, 0), np.nan) if ends is None else np.array([ends["lower"], ends["upper"]], dtype=float)
