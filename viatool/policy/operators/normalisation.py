"""Normalisations: by stored statistics they are affine, by those of the input they are enclosed.

The float32 contract covers the program's own order of operations. A batch normalisation may be computed as
``(x - mean) / spread * scale + shift`` or with the constants joined beforehand, so its factor carries the
roundings of both. A variance may be computed from deviations, as a mean of squares less a squared mean, or by
updates (see `variance`), and what is normalised as a deviation, or with the mean joined to the shift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from viatool.policy.assembly import Computed, Refusal, Term
from viatool.policy.network import Precision
from viatool.policy.operators.linear import scaled_by, scattered, weighted_sum
from viatool.policy.operators.reduction import means, normalised_axes, summed
from viatool.policy.operators.registry import Call, Value, counted, reads
from viatool.policy.operators.variance import normalised, variance
from viatool.policy.tensors import Constant, as_precision, dtype_name
from viatool.rounding import UNIT_ROUNDOFF

_BATCH_ROUNDINGS = 6
"""var + eps, its root, the reciprocal, times scale, times mean, and that of the stored float64 factor."""


@reads("BatchNormalization", 6, 7, 9, 14, 15, treatment="exact", note="inference only")
def read_batch_normalization(call: Call) -> Sequence[Value]:
    """Read a normalisation by stored statistics, channel by channel (axis 1)."""
    training = call.attributes.get("training_mode", 0)
    if training or (call.version == 6 and not call.flag("is_test")):
        raise Refusal("is in training mode", "export the policy in evaluation mode")
    if call.attributes.get("spatial", 1) != 1:
        raise Refusal("has spatial = 0, which no exporter writes any more")
    x = call.computed(0)
    statistics = [
        counted(call.constant(index, name), name)
        for index, name in enumerate(("scale", "shift", "mean", "variance"), start=1)
    ]
    scale, shift, mean, variance = (numbers.values for numbers in statistics)
    roundings = _BATCH_ROUNDINGS + sum(numbers.relative_roundings() for numbers in statistics)
    spread = np.sqrt(variance + call.number("epsilon"))
    if not (np.isfinite(spread).all() and (spread > 0).all()):
        raise Refusal("has a variance that is not positive", "train and export the policy again")
    factor = scale / spread
    trailing = (-1, *(1 for _ in x.shape[2:])) if len(x.shape) > 1 else (-1,)
    if np.broadcast_shapes(x.shape, factor.reshape(trailing).shape) != x.shape:
        raise Refusal(f"has {factor.size} channels for the shape {list(x.shape)}")
    call.assembly.expect_folding(x, roundings)
    offset = np.broadcast_to((-mean * factor).reshape(trailing), x.shape)
    matrix = scattered(call, x, x.shape, np.broadcast_to(factor.reshape(trailing), x.shape).ravel())
    centred = call.assembly.affine([Term(x, matrix)], offset, x.shape, x.precision, roundings)
    addend = Constant(shift.reshape(trailing), x.precision, statistics[1].relative_roundings())
    return [weighted_sum(call, [centred, addend], (1.0, 1.0))]


def standardised(
    call: Call, x: Computed, axes: Sequence[int], epsilon: float, *, centre: bool = True
) -> tuple[Computed, Computed, Computed]:
    """Add ``(x - mean) / sqrt(variance + epsilon)`` along axes; return it, the mean and 1 / spread."""
    if not epsilon > 0:
        raise Refusal(f"has epsilon = {epsilon:g}, where a positive number keeps it defined")
    if centre and math.prod(x.shape[axis] for axis in axes) < 2:
        raise Refusal("normalises single values, which leaves nothing of them")
    assembly = call.assembly
    mean = summed(call, x, axes, keep=True, mean=True)
    deviation = weighted_sum(call, [x, mean], (1.0, -1.0)) if centre else x
    squares = variance(assembly, deviation, means(call, x, axes), mean.shape, uncentred=x if centre else None)
    spread = assembly.activation(assembly.scaled(squares, 1.0, epsilon), "Sqrt")
    reciprocal = assembly.activation(spread, "Reciprocal")
    return normalised(assembly, deviation, reciprocal), mean, reciprocal


def _first_stage(call: Call, x: Computed) -> Computed:
    """Return x in the precision in which an operator with a `stash_type` computes statistics.

    It is that of the attribute, float32 by default, also for a narrower x. Onnxruntime's kernel takes no double for a
    float32 x, and where there is no kernel for doubles they are computed in float32 indeed.
    """
    stash = as_precision(dtype_name(call.integer("stash_type")) or "")
    if stash is None:
        raise Refusal("has a stash_type that is no floating-point type", "export the policy again")
    widest: Precision = "float64" if x.precision == "float64" else "float32"
    return call.assembly.cast(x, max(stash, widest, key=UNIT_ROUNDOFF.__getitem__))


def _scaled_and_shifted(call: Call, x: Computed, scale: Value, shift: Value | None) -> Computed:
    if isinstance(scale, Computed) or isinstance(shift, Computed):
        raise Refusal("takes its scale from the observation")
    result = scaled_by(call, x, counted(scale, "scale"))
    return result if shift is None else weighted_sum(call, [result, shift], (1.0, 1.0))


@reads("LayerNormalization", 17, treatment="enclosed")
def read_layer_normalization(call: Call) -> Sequence[Value]:
    """Read a normalisation over the last axes, with its optional mean and reciprocal spread."""
    x = call.computed(0)
    (axis,) = normalised_axes([call.integer("axis")], x)
    axes, inner = range(axis, len(x.shape)), _first_stage(call, x)
    result, mean, reciprocal = standardised(call, inner, axes, call.number("epsilon"))
    result = call.assembly.cast(result, x.precision)
    shift = call.value(2) if call.has(2) else None
    return [_scaled_and_shifted(call, result, call.value(1), shift), mean, reciprocal]


@reads("RMSNormalization", 23, treatment="enclosed")
def read_rms_normalization(call: Call) -> Sequence[Value]:
    """Read a division by the root mean square over the last axes."""
    x = call.computed(0)
    (axis,) = normalised_axes([call.integer("axis")], x)
    axes, inner = range(axis, len(x.shape)), _first_stage(call, x)
    result, _, _ = standardised(call, inner, axes, call.number("epsilon"), centre=False)
    result = call.assembly.cast(result, x.precision)
    return [_scaled_and_shifted(call, result, call.value(1), None)]


@reads("InstanceNormalization", 6, 22, treatment="enclosed")
def read_instance_normalization(call: Call) -> Sequence[Value]:
    """Read a normalisation of each channel over its positions."""
    x = call.computed(0)
    result, _, _ = standardised(call, x, range(2, len(x.shape)), call.number("epsilon"))
    return [_by_channel(call, result)]


@reads("GroupNormalization", 21, treatment="enclosed")
def read_group_normalization(call: Call) -> Sequence[Value]:
    """Read a normalisation over groups of channels and their positions."""
    x, groups = call.computed(0), call.integer("num_groups")
    if len(x.shape) < 2 or groups < 1 or x.shape[1] % groups:
        raise Refusal(f"has {groups} groups for the shape {list(x.shape)}")
    grouped = _first_stage(call, x).reshaped((x.shape[0], groups, x.size // (x.shape[0] * groups)))
    result, _, _ = standardised(call, grouped, [2], call.number("epsilon"))
    return [_by_channel(call, call.assembly.cast(result, x.precision).reshaped(x.shape))]


def _by_channel(call: Call, x: Computed) -> Computed:
    trailing = (-1, *(1 for _ in x.shape[2:]))
    scale, shift = call.constant(1, "scale"), call.constant(2, "shift")
    if scale.array.size != x.shape[1] or shift.array.size != x.shape[1]:
        raise Refusal(f"has {scale.array.size} channels for the shape {list(x.shape)}")
    scale, shift = (part.rearranged(lambda numbers: numbers.reshape(trailing)) for part in (scale, shift))
    return _scaled_and_shifted(call, x, scale, shift)
