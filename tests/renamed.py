"""Settings in which everything that others name bears one name."""

from dataclasses import replace
from pathlib import Path


def renamed(setting, name):
    """The setting with a map, channels, actions and radii of that name."""
    channels = [c.model_copy(update={"name": name, "unit": name}) for c in setting.spec.observation]
    actions = [
        a.model_copy(update={"name": f"{name}{i}", "unit": name}) for i, a in enumerate(setting.spec.action)
    ]
    return replace(
        setting,
        spec=setting.spec.model_copy(update={"observation": channels, "action": actions}),
        world_map=replace(setting.world_map, name=name, path=Path(name)),
        errors=replace(
            setting.errors,
            given={name: 0.01},
            by_channel={name: 0.01},
            sources={name: name},
            units={name: name},
        ),
        premises=tuple(replace(premise, name=name, value=name, source=name) for premise in setting.premises),
    )
