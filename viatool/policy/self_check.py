"""The gate before every verdict: the loaded network against the program, within what rounding can explain.

The tolerance is not a constant: for each observation it is the smaller of two. A running error analysis follows
the largest rounding of the program through the network: a dot product of n terms errs by at most
``gamma_n * sum |w| |x|``, an activation by its own error plus what its argument's error can move. In a wide or
deep network these bounds multiply to far more than what happens, and a dropped bias would hide below them. So
the rounding is simulated as well: every node errs by its own bound with a random sign (Monte Carlo arithmetic),
and what that does to the actions is what rounding explains. Real rounding is a few hundredths of it. A few
simulations of one observation may cancel by chance; the share of the analysis that they reach over all
observations does not. Where rounding could explain nearly anything, an observation is compared but counts for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.channels import Extent, Quantities, Quantity
from viatool.errors import PolicyError, SelfCheckError
from viatool.policy.executed import Executed
from viatool.policy.maps import normaliser
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.policy.runtime import Runtime
from viatool.policy.specification import PolicySpecification
from viatool.policy.weights import copies as copies_of
from viatool.policy.weights import terms as terms_of
from viatool.rounding import LARGEST, SMALLEST_NORMAL, UNIT_ROUNDOFF

_MARGIN = 8.0
"""Values this close to overflow are not compared: a partial sum may have left the range."""

_ACTIVATION_UNITS = 64.0
"""Error of a runtime's activation in unit roundoffs of max(1, |x|, |f(x)|), above all that was seen."""

_SIMULATIONS = 4
_SIMULATED = 2.0
"""Tolerance in root mean squares of the simulated rounding; what was seen in onnxruntime is below 0.05."""

_SMALLEST = 16.0
"""Least simulated tolerance, in unit roundoffs of max(1, |action|)."""

_NOMINAL = Extent(-2.65, -2.65, 2.65, 2.65)
"""The room from which plausible observations come: goals are up to 15 m away."""

_TELLING = 0.1
"""Largest tolerance of a comparison that tells anything, as a share of how far the action varies."""

_FLAT = 2.0**-10
"""Share of an action that does not vary that stands for how far it does."""

_STRANGE = 1e6
"""How far from all others an observation is that no other may depend on."""

_RANDOM_POINTS = 48
_CORNERS = 16


@dataclass(frozen=True)
class SelfCheck:
    """What the comparison found.

    Parameters
    ----------
    points : int
        Observations that were compared and whose comparison tells something; 0 if rounding explains nearly anything.
    largest_difference : float
        Between the network and the program.
    largest_tolerance : float
        What rounding can explain, at the point where it is largest.
    """

    points: int
    largest_difference: float
    largest_tolerance: float

    @property
    def words(self) -> str:
        """Return what the comparison tells, for a person."""
        if not self.points:
            return (
                "the network as it was read is not checked against onnxruntime: "
                "rounding could explain nearly any difference between them"
            )
        return (
            f"agrees with the network as it was read: {self.points} observations, largest difference "
            f"{self.largest_difference:.2g}, where rounding explains {self.largest_tolerance:.2g}"
        )


def check_executed(
    executed: Executed, program: Runtime, spec: PolicySpecification | None, *, seed: int = 0
) -> SelfCheck:
    """Compare what onnxruntime is said to run with what it computes: as it is deployed, and with nothing rewritten.

    Parameters
    ----------
    executed : Executed
        The network at each level of optimisation.
    program : Runtime
        The deployed program.
    spec : PolicySpecification, optional
        Gives sensible ranges of the observation.
    seed : int
        Of the random points.

    Returns
    -------
    SelfCheck
        Of both.

    Raises
    ------
    SelfCheckError, PolicyError
        As `check_network`.
    """
    plain = check_network(executed.at["none"], program.at("none"), spec, seed=seed)
    deployed = check_network(executed.at[program.optimisation], program, spec, seed=seed)
    return SelfCheck(
        min(plain.points, deployed.points),
        max(plain.largest_difference, deployed.largest_difference),
        max(plain.largest_tolerance, deployed.largest_tolerance),
    )


def check_network(
    network: Network, program: Runtime, spec: PolicySpecification | None, *, seed: int = 0
) -> SelfCheck:
    """Compare a network with the program on nominal, corner and random observations.

    A program that gives the same actions for a batch as one by one is allowed to run batches from then on.

    Parameters
    ----------
    network : Network
        As read.
    program : Runtime
        The deployed program.
    spec : PolicySpecification, optional
        Gives sensible ranges of the observation.
    seed : int
        Of the random points.

    Raises
    ------
    SelfCheckError
        If they differ by more than rounding can explain.
    PolicyError
        If the network overflows on all of them.
    """
    points = check_points(network, spec, seed)
    if network.nodes[0].precision != "float64":
        kind = np.float16 if network.nodes[0].precision == "float16" else np.float32
        with np.errstate(over="ignore"):  # what is not finite is left out below
            points = points.astype(kind).astype(np.float64)
    values, errors = propagate_rounding(network, points)
    usable = _fit(network, values)
    if not usable.any():
        raise PolicyError(
            "the network overflows or is undefined on every observation of the self-check",
            "check the weights, and the ranges in the specification",
        )
    points, values = points[usable], [value[usable] for value in values]
    actions = program.rows(points)
    expected = values[-1]
    largest = errors[-1][usable]
    tolerance = np.minimum(largest, simulate_rounding(network, points, values, largest, seed))
    if actions.shape != expected.shape:
        raise SelfCheckError(
            f"onnxruntime gives {actions.shape[-1]} actions, the loaded network {expected.shape[-1]}",
            "report this model: it was read wrongly",
        )
    difference = np.abs(actions - expected)
    apart = ~(difference <= tolerance) & np.isfinite(tolerance)
    if apart.any():
        excess = np.where(apart, np.nan_to_num(difference - tolerance, nan=np.inf), -np.inf)
        worst = np.unravel_index(np.argmax(excess), excess.shape)
        raise SelfCheckError(
            f"the loaded network and onnxruntime disagree in action {worst[1]}: {expected[worst]:.9g} "
            f"against {actions[worst]:.9g}, where rounding explains {tolerance[worst]:.2g}",
            "report this model: it was read wrongly, and no verdict may rest on it",
        )
    program.batches = _batches(program, points, expected, tolerance)
    telling = _tells(expected, tolerance)
    return SelfCheck(
        int(telling.sum()),
        float(difference[telling].max(initial=0.0)),
        float(tolerance[telling].max(initial=0.0)),
    )


def _fit(network: Network, values: list[Floats]) -> Booleans:
    """Return at which points (B,) no value and no partial sum comes near the largest number of its precision."""
    fits = np.ones(len(values[0]), dtype=bool)
    with np.errstate(all="ignore"):
        for node, value, own in zip(network.nodes, values, _own_errors(network, values), strict=True):
            most = LARGEST[node.precision] / _MARGIN
            fits &= ((np.abs(value) < most) & np.isfinite(own)).all(axis=1)
    return fits


def _tells(expected: Floats, tolerance: Floats) -> Booleans:
    """Return at which points (B,) the tolerance is small beside what the actions do."""
    varies = np.ptp(expected, axis=0)
    size = np.maximum(varies, _FLAT * np.maximum(1.0, np.abs(expected).max(axis=0)))
    return np.asarray((tolerance <= _TELLING * size).all(axis=1))


def _batches(program: Runtime, points: Floats, expected: Floats, tolerance: Floats) -> bool:
    """Whether a batch, in another order and beside any stranger, gives each observation its own action.

    What is no number spreads to whatever reads it, also through a gate that is closed: 0 times infinity is not 0.
    """
    generator = np.random.default_rng(1)
    order = generator.permutation(len(points))
    large = _STRANGE * generator.normal(size=points.shape[1])
    for stranger in (np.nan, np.inf, -np.inf, large):
        row = np.broadcast_to(stranger, (1, points.shape[1]))
        try:
            actions = program.batch(np.concatenate([row, points[order], row]))[1:-1]
        except PolicyError:
            return False
        allowed = tolerance[order]
        if actions.shape != expected.shape or not bool(
            ((np.abs(actions - expected[order]) <= allowed) | np.isposinf(allowed)).all()
        ):
            return False
    return True


def check_points(network: Network, spec: PolicySpecification | None, seed: int = 0) -> Floats:
    """Return the observations of the check, ``(P, size)``.

    Nominal ones, corners of a box and random ones, some of them such that what the model's own normaliser makes
    of them is of the order of 1, whatever the units of the observation are.
    """
    size = network.input_size
    lower, upper = _plausible_range(size, spec)
    middle = (lower + upper) / 2
    generator = np.random.default_rng(seed)
    corners = np.where(generator.random((_CORNERS, size)) < 0.5, lower, upper)
    random = lower + (upper - lower) * generator.random((_RANDOM_POINTS, size))
    wide = generator.normal(size=(_RANDOM_POINTS, size)) * 10.0 ** generator.uniform(
        -3, 1, (_RANDOM_POINTS, 1)
    )
    plausible = np.concatenate([[middle, lower, upper, np.zeros(size)], corners, random])
    if spec is not None and spec.observation_size == size:
        fixed = spec.fixed_values()
        plausible[:, ~np.isnan(fixed)] = fixed[~np.isnan(fixed)]
    first = normaliser(network)
    if first is None or not first.factor.all():
        return np.concatenate([plausible, wide])
    normal = generator.normal(size=(_RANDOM_POINTS, size))
    with np.errstate(over="ignore"):
        return np.concatenate([plausible, wide, (normal - first.offset) / first.factor])


def _plausible_range(size: int, spec: PolicySpecification | None) -> tuple[Floats, Floats]:
    if spec is None or spec.observation_size != size:
        return np.full(size, -1.0), np.full(size, 1.0)
    quantities = Quantities.of(spec.observation, frames=spec.frames)
    nominal = [_range_of(quantity) for quantity in quantities]
    sizes = [channel.size for channel in spec.observation]
    ends = [
        quantities.inputs.encode(np.repeat(np.array(side), sizes)[None])[0]
        for side in zip(*nominal, strict=True)
    ]
    finite = [np.where(np.isfinite(end), end, 1.0) for end in ends]  # the reciprocal of a range of 0
    return np.minimum(*finite), np.maximum(*finite)


def _range_of(quantity: Quantity) -> tuple[float, float]:
    """Return the bounds of a quantity on a robot that is not known yet; -1 to 1 where its kind tells none."""
    try:
        return quantity.bounds(_NOMINAL)
    except PolicyError:
        return -1.0, 1.0


def propagate_rounding(network: Network, points: Floats) -> tuple[list[Floats], list[Floats]]:
    """Return the float64 value of every node and how far the program may be from it, ``(B, size)`` each.

    Notes
    -----
    First-order error analysis at points; activations are evaluated at both ends of their argument's error.
    **Sound:** up to the monotonicity of activations within that error; a check, not a proof.
    """
    with np.errstate(all="ignore"):
        values = network.values(points)
        errors: list[Floats] = []
        for node, value in zip(network.nodes, values, strict=True):
            error = _error(node, value, values, errors)
            size = np.abs(value) + error
            errors.append(np.where(size < LARGEST[node.precision] / _MARGIN, error, np.inf))
    return values, errors


def simulate_rounding(
    network: Network, points: Floats, values: list[Floats], largest: Floats, seed: int = 0
) -> Floats:
    """Return what simulated rounding makes of the actions, ``(B, A)``, with a margin.

    Parameters
    ----------
    network : Network
        A actions.
    points, values : ndarray
        ``(B, size)`` observations and the values of every node on them.
    largest : ndarray
        ``(B, A)``, from the analysis; infinite where it says nothing.
    seed : int
        Of the signs.
    """
    if any(isinstance(node, Activation) and node.function.jumps for node in network.nodes):
        # a rare error may jump far, which no few simulations show: only the analysis counts
        return np.full(values[-1].shape, np.inf)
    generator = np.random.default_rng(seed)
    squares = [np.zeros_like(value) for value in values]
    with np.errstate(all="ignore"):
        own = _own_errors(network, values)
        for _ in range(_SIMULATIONS):
            noise = [np.where(generator.random(error.shape) < 0.5, error, -error) for error in own]
            for total, noisy, value in zip(squares, network.values(points, noise), values, strict=True):
                total += (noisy - value) ** 2
        spreads = [_SIMULATED * np.sqrt(total / _SIMULATIONS) for total in squares]
        deviation = np.where(_stay_defined(network, values, spreads)[:, None], spreads[-1], np.inf)
        known = np.isfinite(largest)
        share = np.nan_to_num(np.where(largest > 0.0, deviation / largest, 0.0), nan=1.0, posinf=1.0)
        mean_share = np.square(share).sum(axis=0, where=known) / np.maximum(known.sum(axis=0), 1)
        unshared = np.sqrt(np.square(deviation).mean(axis=0))  # where there is no analysis to take a share of
        common = np.where(known, np.sqrt(mean_share) * np.where(known, largest, 0.0), unshared)
    simulated = np.maximum(deviation, common)
    least = _SMALLEST * UNIT_ROUNDOFF[network.nodes[-1].precision] * np.maximum(1.0, np.abs(values[-1]))
    return np.where(np.isfinite(simulated), np.maximum(simulated, least), np.inf)


def _stay_defined(network: Network, values: list[Floats], spreads: list[Floats]) -> Booleans:
    """Return at which points (B,) rounding, of whatever sign, leaves every argument in the domain of its function."""
    defined = np.ones(len(values[0]), dtype=bool)
    for node in network.nodes:
        if isinstance(node, Activation):
            for side in (-1.0, 1.0):
                moved = node.function(values[node.source] + side * spreads[node.source])
                defined &= np.isfinite(moved).all(axis=1)
    return defined


def _own_errors(network: Network, values: list[Floats]) -> list[Floats]:
    """Return how far the program may be from each node when it is right about those before it."""
    exact = [np.zeros_like(value) for value in values]
    return [_error(node, value, values, exact) for node, value in zip(network.nodes, values, strict=True)]


def _error(node: Node, value: Floats, values: list[Floats], errors: list[Floats]) -> Floats:
    """Return how far the program may be from the value of a node when its sources have the given errors."""
    unit, tiny = UNIT_ROUNDOFF[node.precision], SMALLEST_NORMAL[node.precision]
    match node:
        case Input():
            return np.zeros_like(value)  # the points are representable
        case Affine():
            return _affine_error(node, values, errors, unit, tiny)
        case Activation():
            return _activation_error(node, values[node.source], value, errors[node.source], unit)
        case Product():
            left, right = errors[node.left], errors[node.right]
            error = np.abs(values[node.left]) * right + np.abs(values[node.right]) * left + left * right
            return error + unit * (np.abs(value) + error) + tiny
        case Maximum() | Minimum():
            return np.maximum(errors[node.left], errors[node.right])
        case Cast():
            return errors[node.source] + unit * (np.abs(value) + errors[node.source]) + tiny


def _affine_error(
    node: Affine, values: list[Floats], errors: list[Floats], unit: float, tiny: float
) -> Floats:
    terms = np.zeros(node.size)
    inherited = np.zeros((len(values[0]), node.size))
    magnitude = np.broadcast_to(node.bias_magnitude, inherited.shape)
    for source, absolute, merged in zip(node.sources, node.absolute_weights, node.magnitudes, strict=True):
        terms = terms + terms_of(merged)
        inherited = inherited + errors[source] @ absolute.T
        magnitude = magnitude + (np.abs(values[source]) + errors[source]) @ merged.T
    roundings = (terms + 1 + node.roundings) * unit
    signs = [copies_of(weight) for weight in node.magnitudes]
    copies = (terms == 1) & (node.bias == 0) & (node.roundings == 0) & np.all(signs, axis=0)
    stored = (terms == 0) & (node.roundings == 0)
    factor = np.where(copies | stored, 0.0, roundings / np.maximum(1 - roundings, 1e-3))
    error: Floats = inherited + factor * magnitude + (factor > 0) * terms * tiny
    fits = magnitude < LARGEST[node.precision] / _MARGIN  # a partial sum may be larger than the result
    return np.where(fits, error, np.inf)


def _activation_error(node: Activation, x: Floats, value: Floats, inherited: Floats, unit: float) -> Floats:
    if node.function.passes_on:
        limits = node.function.named
        inside = (x - inherited >= limits["min"]) & (x + inherited <= limits["max"])
        return np.where(inside | (node.function.name == "Known"), inherited, np.inf)
    moved = np.zeros_like(value)
    for step in (-1.0, -0.5, 0.5, 1.0):
        moved = np.maximum(moved, np.abs(node.function(x + step * inherited) - value))
    undefined = np.isnan(moved) | ~np.isfinite(
        inherited
    )  # rounding may leave the domain, as that of a logarithm
    moved = np.where(undefined, np.inf, moved)
    units = _ACTIVATION_UNITS if node.function.error.units else 0.0
    size = node.function.amplitude * np.maximum(1.0, np.maximum(np.abs(x), np.abs(value)))
    return moved + units * unit * size
