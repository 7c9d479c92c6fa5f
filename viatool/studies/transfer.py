"""The stand-in for the paper's Table III: a policy that moves to another robot, in simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from viatool.schedule import Progress
from viatool.studies.study import Data, Options, Page, Study
from viatool.studies.tables import table
from viatool.studies.tasks import Record, Task

if TYPE_CHECKING:
    from pathlib import Path

    from viatool.simulate import Conditions
    from viatool.verification.result import Result

POLICY, MAP = "via", "lab"
SEED = 3000003  # of scenarios that no training and no selection has seen


@dataclass(frozen=True)
class Place:
    """Where the policy drives.

    Parameters
    ----------
    name, title : str
        In files and in tables.
    engine, robot : str
        As for ``viatool simulate``.
    conditions : mapping
        As for `Conditions`.
    """

    name: str
    title: str
    engine: str
    robot: str
    conditions: tuple[tuple[str, float], ...] = ()

    def as_conditions(self) -> Conditions:
        """Return the conditions as the simulators take them."""
        from viatool.simulate import Conditions

        chosen: dict[str, Any] = dict(self.conditions)
        return Conditions(**chosen)


PLACES = (
    Place("kinematic", "Kinematic lab", "kinematic", "turtlebot3"),
    Place("physics", "Physics, TurtleBot3", "bullet", "turtlebot3"),
    Place("jackal", "Physics, Jackal", "bullet", "jackal"),
    Place(
        "jackal-rough",
        "Physics, Jackal, rough",
        "bullet",
        "jackal",
        (("noise", 0.03), ("dropout", 0.02), ("delay", 0.1), ("drift", 0.01)),
    ),
)

# Mean and standard deviation: in simulation, and on a Jackal in a laboratory.
_PAPER: dict[str, tuple[str, str]] = {
    "success": ("98.3 ± 4.9", "90.0 ± 6.3"),
    "collision": ("1.7 ± 4.9", "8.0 ± 4.0"),
    "sampled_success": ("99.6 ± 0.6", "99.9 ± 0.1"),
    "sampled_collision": ("94.4 ± 0.2", "91.0 ± 2.2"),
    "sampled": ("99.1 ± 0.6", "99.2 ± 0.6"),
    "width_v": ("0.019 ± 0.003", "0.020 ± 0.003"),
    "width_omega": ("0.087 ± 0.018", "0.099 ± 0.014"),
}
_ROWS = (
    ("success", "Success rate [%]"),
    ("collision", "Collision rate [%]"),
    ("timeout", "Timeout rate [%]"),
    ("cost", "Steps in danger per episode"),
    ("sampled_success", "Safety (Succ.), sampled [%]"),
    ("sampled_collision", "Safety (Coll.), sampled [%]"),
    ("sampled", "Overall safety, sampled [%]"),
    ("proved_success", "Safety (Succ.), proved [%]"),
    ("proved_collision", "Safety (Coll.), proved [%]"),
    ("proved", "Overall safety, proved [%]"),
    ("danger", "Proved at d_danger [%]"),
    ("width_v", "Reachable set width v [m/s]"),
    ("width_omega", "Reachable set width omega [rad/s]"),
    ("states", "States"),
)


_EXPLANATION = (
    "Clearance is measured as the paper's text has it, from the LiDAR (d_col 0.4 m, d_danger 0.5 m), in every place. "
    "The proof is for the unicycle model over one control interval, with the dead time of the place where it has one; "
    "the mass, the acceleration and the slip of the physics engine are not part of it. What they, noise and drift do "
    "to the observations is in the states that were verified.",
)


@dataclass(frozen=True)
class DriveAndVerify(Task):
    """Drive the policy in one place, and verify it on the trajectory that it drove there.

    Parameters
    ----------
    place : Place
        Where.
    scenarios : int
        Drawn by the map's generator.
    eps : float
        Sensor error of the verification.
    """

    place: Place
    scenarios: int
    eps: float

    @property
    def name(self) -> str:
        """Return ``transfer/PLACE``."""
        return f"transfer/{self.place.name}"

    @property
    def work(self) -> float:
        """Estimate by the speed of the engine."""
        return self.scenarios * (0.5 if self.place.engine == "bullet" else 0.1)

    def parameters(self) -> dict[str, Any]:
        """Return the place, the scenarios, and what the policy and the map are."""
        from viatool.policy import load_policy
        from viatool.world import load_map

        return {
            **asdict(self),
            "seed": SEED,
            "policy": load_policy(POLICY).sha256,
            "map": load_map(MAP).sha256,
        }

    def run(self, output: Path, progress: Progress) -> dict[str, Any]:
        """Drive, verify, and return the figures."""
        from viatool.policy import load_policy
        from viatool.setting.setting import Setting
        from viatool.setting.wishes import Wishes
        from viatool.simulate import simulate
        from viatool.verification import verify
        from viatool.versions import installed_versions
        from viatool.world import load_map

        policy, world_map = load_policy(POLICY), load_map(MAP)
        assert world_map.generator is not None
        scenarios = world_map.generator.draw(self.scenarios, SEED)
        conditions = self.place.as_conditions()
        simulation = simulate(
            policy,
            Setting.of(policy, world_map, 0.0, Wishes(robot=self.place.robot), scenarios),
            engine=self.place.engine,
            conditions=conditions,
            seed=SEED,
            progress=lambda _, done, total, line="": progress(
                f"{done} of {total} driven", 0.7 * done / total, 1.0
            ),
        )
        result = verify(
            policy,
            world_map,
            eps=self.eps,
            trajectory=simulation.drive.trajectory,
            delay=conditions.delay,
            robot=self.place.robot,
            progress=lambda stage, done, total, line="": progress(
                stage, 0.7 + 0.3 * done / max(total, 1), 1.0
            ),
        )
        found = simulation.statistics
        shares = {
            name: {**asdict(share), "interval": share.interval}
            for name, share in (
                ("success", found.success),
                ("collision", found.collision),
                ("timeout", found.timeout),
            )
        }
        return {
            "task": {**shares, "cost": found.average_cost},
            "verified": _verified(result),
            "versions": installed_versions(),
        }


def _verified(result: Result) -> dict[str, Any]:
    """Return the rates and widths of a verification."""
    document = result.to_json()
    names = ("states", "safety_rate", "sampled_safety_rate", "danger_rate", "reachable_width")
    return {name: document[name] for name in names}


def _plan(options: Options) -> Sequence[Task]:
    return [DriveAndVerify(place, options.scenarios, options.eps) for place in PLACES]


def _collect(tasks: Sequence[Task], records: Mapping[str, Record]) -> Data:
    done = [task for task in tasks if task.name in records and isinstance(task, DriveAndVerify)]
    return {
        "scenarios": done[0].scenarios,
        "eps": done[0].eps,
        "dates": sorted({records[task.name].finished for task in done}),
        "versions": records[done[0].name].result["versions"],
        "places": {task.place.name: _figures(records[task.name].result) for task in done},
    }


def _figures(found: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of the cells of one column."""
    task, verified = found["task"], found["verified"]
    cells = {name: _share(task[name]) for name in ("success", "collision", "timeout")}
    for name, rates in (("sampled", "sampled_safety_rate"), ("proved", "safety_rate")):
        for suffix, outcome in (("", "overall"), ("_success", "success"), ("_collision", "collision")):
            cells[name + suffix] = _rate(verified[rates][outcome])
    widths = verified["reachable_width"]
    return {
        **cells,
        "cost": f"{task['cost']:.2f}",
        "danger": _rate(verified["danger_rate"]["overall"]),
        "width_v": f"{widths['v']['mean']:.4f} ± {widths['v']['std']:.4f}",
        "width_omega": f"{widths['omega']['mean']:.3f} ± {widths['omega']['std']:.3f}",
        "states": f"{verified['states']:,}",
    }


def _share(share: Mapping[str, Any]) -> str:
    low, high = share["interval"]
    return f"{100.0 * share['count'] / share['total']:.1f} [{100.0 * low:.1f}, {100.0 * high:.1f}]"


def _rate(rate: Mapping[str, Any]) -> str:
    """Return a rate in per cent, rounded down, or n/a of no states."""
    from viatool.report.numbers import percentage

    return percentage(rate["safe"], rate["total"], 3).removesuffix(" %")


def _render(data: Data) -> Page:
    known = [place for place in PLACES if place.name in data["places"]]
    versions = ", ".join(f"{name} {version}" for name, version in data["versions"].items())
    header = ["", *(place.title for place in known), "Paper, simulation", "Paper, Jackal"]
    rows = [
        [
            title,
            *(data["places"][place.name][name] for place in known),
            *_PAPER.get(name, ("", "")),
        ]
        for name, title in _ROWS
    ]
    lines = [
        "# Transfer to another robot, in simulation",
        "",
        "**All of this is simulation.** The paper's Table III has a physical Clearpath Jackal in a laboratory; here a "
        "physics engine with the body of a Jackal stands in for it, so these figures say how the policy copes with "
        "another body, noise, latency and drift, and nothing about a real robot.",
        "",
        f"    {data['command']}",
        "",
        f"{', '.join(data['dates'])}, 2-core x86-64; {versions}. Written from `data/{data['study']}.json`.",
        "",
        f"The policy `{POLICY}` drives the same {data['scenarios']} random scenarios of the map `{MAP}` (seed {SEED}) "
        f"in each place, and is verified at eps {data['eps']:g} on the states that it visits there. Shares with 95 % "
        "intervals (Wilson); safety rates rounded down; widths of the reachable set: mean ± standard deviation over "
        "the states. The paper: mean ± standard deviation over its seeds, by the sampled criterion.",
        "",
        *table(header, rows),
        "Where the policy drives:",
        "",
        *(f"- *{place.title}*: `{_words(place, data['scenarios'])}`" for place in PLACES),
        "",
        *_EXPLANATION,
    ]
    return Page("\n".join(lines).rstrip() + "\n")


def _words(place: Place, scenarios: int) -> str:
    """Return the command that drives the policy in a place."""
    options = [f"--{name.replace('_', '-')} {value:g}" for name, value in place.conditions]
    words = [f"viatool simulate {POLICY} --map {MAP} --engine {place.engine} --robot {place.robot}", *options]
    return " ".join([*words, f"--episodes {scenarios} --seed {SEED}"])


STUDY = Study(
    "transfer", "from the kinematic lab to a Jackal in the physics engine", _plan, _collect, _render
)
