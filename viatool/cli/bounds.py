"""``viatool bounds``: reachable sets of given observations, without any geometry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.terminal import open_console
from viatool.errors import ConfigurationError

if TYPE_CHECKING:
    from viatool.policy import Policy


@click.command(cls=Command)
@options.policy_argument
@click.argument("observations", type=options.READABLE)
@options.eps_option
@options.spec_option
@options.graph_options
@options.bounds_options
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FILE|vnnlib:DIR",
    help="Write observation, eps, lower and upper (npz, csv), or a folder with the model and a VNN-LIB query for each "
    "observation, by which another verifier can confirm the bounds. Repeatable.",
)
@click.option(
    "--symbolic",
    type=click.IntRange(min=0),
    metavar="ROW",
    help="Print the actions around one observation as polynomials of the sensor errors, and what each error moves.",
)
@options.threads_option
@options.quiet_option
def command(**given: Any) -> None:
    """Bound the actions of POLICY (ONNX) for all sensor errors around OBSERVATIONS.

    OBSERVATIONS is a .npy, .npz (array 'observation'), .csv or .txt file with one observation on each line.
    """
    from viatool.cli.observations import load_observations
    from viatool.policy import load_policy
    from viatool.report import parse_bounds_output, print_bounds, print_symbolic
    from viatool.taylor import reach, symbolic_actions

    outputs = [parse_bounds_output(text) for text in given["output"]]
    policy = load_policy(
        given["policy"],
        given["spec_path"],
        input_name=given["graph_input"],
        output_name=given["graph_output"],
    )
    remembered = 0 if policy.spec is None else len(policy.spec.initial_memory)
    for output in outputs:
        output.require_serving(policy)
    observations = load_observations(given["observations"], policy.input_size, remembered)
    eps = radii(policy, given["eps"])
    settings = {name: given[name] for name in ("order", "approximation", "refine", "arithmetic")}
    reachable = reach(policy, observations, eps, **settings)
    for output in outputs:
        output.write(policy, observations, eps, reachable)
    if not given["quiet"]:
        print_bounds(policy, reachable, open_console())
    if given["symbolic"] is not None:
        row = given["symbolic"]
        if row >= len(observations):
            raise ConfigurationError(
                f"--symbolic {row}: there are {len(observations)} observations", "count the rows from 0"
            )
        del settings["refine"]
        print_symbolic(symbolic_actions(policy, observations[row], eps, **settings), open_console())


def radii(policy: Policy, eps: dict[str, float]) -> Any:
    """Return the radius of every observation entry; without a specification one radius for all."""
    from viatool.setting.sensor_errors import SensorErrors

    if policy.spec is not None:
        return SensorErrors.of(policy.spec, eps).radii
    if not eps:
        raise ConfigurationError("no eps is given", "add --eps RADIUS")
    if set(eps) != {""}:
        raise ConfigurationError(
            "a policy without a specification has no named channels",
            "give one --eps RADIUS for all entries, or the channels with --spec",
        )
    return eps[""]
