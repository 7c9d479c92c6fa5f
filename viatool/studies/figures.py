"""The paper's trajectory figure with reachable tubes, learning curves, and lambda and u over the training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from viatool.studies.comparison import about
from viatool.studies.curves import SMOOTHED, draw_constraint, draw_learning, summary_of
from viatool.studies.driven import LOOKAHEAD, draw_paths, hardest_scenario, scene_of, thinned
from viatool.studies.study import Data, Options, Page, Study
from viatool.studies.tables import head
from viatool.studies.tasks import Record, Task
from viatool.studies.training import EvaluateSeed, TrainVariant
from viatool.studies.variants import EVERY, SETTINGS, plan

_DRAWN = ("success_rate", "collision_rate", "episode_cost", "cvar", "var", "multiplier")


def _plan(options: Options) -> Sequence[Task]:
    every = [task for setting in SETTINGS.values() for task in plan(setting, EVERY, options)]
    return list({task.name: task for task in every}.values())


def _collect(tasks: Sequence[Task], records: Mapping[str, Record]) -> Data:
    trainings = [task for task in tasks if isinstance(task, TrainVariant)]
    return {
        "about": about(trainings, list(records.values())),
        "settings": {
            name: found for name in SETTINGS if (found := _collect_setting(name, tasks, records)) is not None
        },
    }


def _collect_setting(
    name: str, tasks: Sequence[Task], records: Mapping[str, Record]
) -> dict[str, Any] | None:
    from viatool.world import load_map

    by_folder = {
        task.folder: task for task in tasks if isinstance(task, TrainVariant) and task.name in records
    }
    folders = {variant.name: f"{SETTINGS[name].home(variant).name}/{variant.name}" for variant in EVERY}
    trainings = {variant: by_folder[folder] for variant, folder in folders.items() if folder in by_folder}
    if not any(task.folder.startswith(f"{name}/") for task in trainings.values()):
        return None
    driven = {
        variant: [
            records[task.name].result
            for task in tasks
            if isinstance(task, EvaluateSeed) and task.training == training and task.name in records
        ]
        for variant, training in trainings.items()
    }
    every = [found for evaluations in driven.values() for found in evaluations]
    if not every:
        return None
    index = hardest_scenario(every)
    configuration = list(trainings.values())[-1].configuration  # of a constrained one, if there is any
    world_map = load_map(configuration.maps[0])
    return {
        "cost_limit": configuration.cost_limit,
        "curves": {
            variant: {metric: summary_of(records[task.name].result["curves"][metric]) for metric in _DRAWN}
            for variant, task in trainings.items()
        },
        "scene": scene_of(world_map, world_map.scenarios[index]),
        "paths": {
            variant: [thinned(found["paths"][index]) for found in evaluations]
            for variant, evaluations in driven.items()
            if evaluations
        },
    }


def _render(data: Data) -> Page:
    lines = head(
        "Figures: paths, learning, and the constraint",
        data,
        "Every method and alpha, all seeds.",
    )
    pictures: dict[str, bytes] = {}
    found = data["settings"]
    if not found:
        return Page("\n".join([*lines, "No policy is trained and evaluated yet."]) + "\n")
    for name, setting in found.items():
        title = SETTINGS[name].title
        pictures[f"paths-{name}.png"] = draw_paths(setting["scene"], setting["paths"])
        pictures[f"learning-{name}.png"] = draw_learning(setting["curves"])
        lines += [
            f"## Paths in {title}",
            "",
            f"Scenario `{setting['scene']['name']}`, the fixed scenario that the fewest policies master, or, "
            "among equals, the one with the longest detours. A tube is the union, over the visited states, of where "
            f"every command that is reachable at eps 0.01 would lead if it were held for {LOOKAHEAD:g} s; the proof "
            "looks at the control interval alone.",
            "",
            f"![Paths with reachable tubes](paths-{name}.png)",
            "",
            f"## Learning curves in {title}",
            "",
            "Episodes of the training, driven with exploration noise: mean over the seeds, and from the lowest to the "
            f"highest of them, smoothed over {SMOOTHED} epochs.",
            "",
            f"![Success, collisions and cost over the epochs](learning-{name}.png)",
            "",
        ]
    pictures["constraint.png"] = draw_constraint(
        {name: (SETTINGS[name].title, one["curves"], one["cost_limit"]) for name, one in found.items()}
    )
    lines += [
        "## The multiplier, the value at risk and the tail of the cost",
        "",
        "Mean over the seeds, and from the lowest to the highest; the CVaR is measured on the few low-noise episodes "
        f"of an epoch, and smoothed over {SMOOTHED}. Where lambda is 0, the actor of every constrained method "
        "maximises the same as that of TD3.",
        "",
        "![lambda, u and CVaR over the epochs](constraint.png)",
    ]
    return Page("\n".join(lines).rstrip() + "\n", pictures)


STUDY = Study(
    "figures", "paths with reachable tubes, learning curves, lambda and u", _plan, _collect, _render
)
