"""What a policy file holds, for a person: its ports, its layers, its maps and its meaning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from viatool.channels.channel import NOW
from viatool.report.foreign import shown
from viatool.report.numbers import MISSING, count, counted
from viatool.report.summaries import print_facts

if TYPE_CHECKING:
    from viatool.policy import ActionChannel, Inspection, PolicySpecification
    from viatool.policy.inspection import Value

_LAYERS_SHOWN = 40


def print_inspection(found: Inspection, console: Console) -> None:
    """Print what was found in a model file."""
    print_facts(found.path, _facts(found), console)
    if found.layers:
        _print_layers(found, console)
    if found.specification is None:
        works = "bounds work, " if found.verifiable else ""
        hint = f"  none: {works}geometry needs --spec FILE (--write-spec FILE proposes one)"
        console.print(Text("specification", style="bold"), Text(hint), sep="\n")
    else:
        _print_specification(found.specification, console)


def _facts(found: Inspection) -> list[tuple[str, str]]:
    facts = [
        ("written by", f"{found.producer or 'unknown'}, opset {found.opset}, IR version {found.ir_version}"),
        ("sha256", found.sha256),
        *_values("input", found.inputs, _roles(found)),
        *_values("output", found.outputs, _roles_of_outputs(found)),
        ("operators", ", ".join(f"{number} {name}" for name, number in found.operators.items()) or "none"),
    ]
    if found.layers:
        weights = sum(layer.parameters for layer in found.layers)
        neurons = ", ".join(f"{number} {name}" for name, number in found.activations.items())
        facts += [
            ("network", f"{counted(len(found.layers), 'layer')}, {count(weights)} numbers that are not 0"),
            ("activations", neurons or "none: the policy is linear"),
        ]
    if found.maps is not None:
        facts += [("before the network", found.maps.before), ("after the network", found.maps.after)]
    if found.self_check is not None:
        facts.append(("onnxruntime", found.self_check.words))
    return facts


def _roles(found: Inspection) -> dict[str, str]:
    """Return what each input of the model takes; nothing where that is not settled."""
    if found.ports is None:
        return {}
    if len(found.ports.each) == 1:
        return {found.ports.names[0]: "the observation"}
    spec = found.specification
    in_order = [value.name for value in found.inputs if value.name in found.ports.names]
    is_told = found.memory or (spec is not None and spec.input is not None)
    order = "" if is_told or in_order != list(found.ports.names) else ", joined in the graph's order"
    guessed = " (guessed from its name)" if spec is None else ""
    return {
        name: f"{place.start} to {place.stop - 1} of the observation"
        + (
            f", memory: what {found.memory[name]} gave in the step before{guessed}"
            if name in found.memory
            else order
        )
        for name, place in found.ports.places.items()
    }


def _roles_of_outputs(found: Inspection) -> dict[str, str]:
    """Return what each output of the model gives, as far as that is known."""
    roles = {} if found.action is None else {found.action: "the action"}
    spec = found.specification
    if spec is not None:
        entries = [str(action.entry) for action in spec.action if action.entry is not None]
        roles |= {name: f"the action: its entries {', '.join(entries)}" for name in roles if entries}
    return roles | {
        made: f"memory: taken by {source} in the next step" for source, made in found.memory.items()
    }


def _values(kind: str, values: Sequence[Value], roles: dict[str, str]) -> list[tuple[str, str]]:
    return [(kind if index == 0 else "", _value(v, kind, roles)) for index, v in enumerate(values)]


def _value(value: Value, kind: str, roles: dict[str, str]) -> str:
    shape = f" [{', '.join(map(str, value.shape))}]" if value.shape else ""
    text = f"{value.name}: {value.dtype}{shape}"
    if value.name in roles:
        return f"{text}, {roles[value.name]}"
    if kind == "input":
        return f"{text}, not used" if roles else text
    return f"{text}, of {', '.join(value.depends_on)}" if value.depends_on else f"{text}, constant"


def _print_layers(found: Inspection, console: Console) -> None:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    for name in ("layer", "kind", "size", "reads", "numbers", "precision"):
        table.add_column(name, justify="left" if name in ("kind", "precision") else "right")
    for index, layer in enumerate(found.layers[:_LAYERS_SHOWN], start=1):
        table.add_row(
            str(index),
            layer.kind,
            str(layer.size),
            ", ".join(map(str, layer.sources)),
            count(layer.parameters) if layer.parameters else "",
            layer.precision,
        )
    console.print(table)
    if len(found.layers) > _LAYERS_SHOWN:
        console.print(
            f"and {count(len(found.layers) - _LAYERS_SHOWN)} more; --output json:FILE lists them all"
        )


def _print_specification(spec: PolicySpecification, console: Console) -> None:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    taken = ("the network takes",) if spec.schema_version > 1 else ()
    for name in ("channel", "size", "unit", "kind", "range or value", *taken, "eps"):
        table.add_column(name, justify="right" if name in ("size", "eps") else "left")
    for channel in spec.observation:
        value = MISSING if channel.value is None else f"fixed to {channel.value:g}"
        if channel.kind == "memory":
            value = f"begins with {channel.initial or 0}"
        if channel.lidar is not None:
            value = f"{channel.lidar.minimum_range:g} to {channel.lidar.maximum_range:g}"
            value += f", {channel.lidar.lidar().words}" if taken else ""
        frames = (channel.frames or spec.frames or NOW).words
        encoded = ["; ".join(filter(None, (channel.encoding.words or "value", frames)))] if taken else []
        eps = "" if channel.eps is None else f"{channel.eps:g}"
        _add_row(table, channel.name, str(channel.size), channel.unit, channel.kind, value, *encoded, eps)
    table.add_section()
    for action in spec.action:
        limits = f"{action.lower:g} to {action.upper:g}"
        if action.commands is not None:
            limits = f"the largest of {len(action.commands)} numbers selects a command"
        _add_row(
            table,
            action.name,
            str(action.outputs),
            action.unit,
            action.kind,
            limits,
            *("" for _ in taken),
            "",
        )
    console.print(table)
    if spec.choice is not None:
        _print_choice(spec.choice, console)
    facts = [
        ("robot", spec.robot),
        ("control interval", f"{spec.control_interval:g} s"),
        *((f"training {n}", str(v)) for n, v in spec.training.items() if not isinstance(v, dict | list)),
    ]
    print_facts("specification", facts, console)


def _print_choice(choice: ActionChannel, console: Console) -> None:
    """Print the commands among which a policy chooses."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    for name in (f"'{choice.name}' selects", *(choice.axes or ())):
        table.add_column(Text(shown(name)), justify="right")
    for number, command in enumerate(choice.commands or ()):
        _add_row(table, str(number), *(f"{part:g}" for part in command))
    console.print(table)


def _add_row(table: Table, *texts: str) -> None:
    table.add_row(*(Text(shown(text)) for text in texts))
