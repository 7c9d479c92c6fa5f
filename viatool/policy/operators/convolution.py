"""Convolutions and pooling: windows over the last axes, found once as element numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.assembly import Computed, Counted, Refusal, Term
from viatool.policy.operators.reduction import tournament
from viatool.policy.operators.registry import Call, Value, counted, reads
from viatool.policy.weights import Weights, placed

Shape = tuple[int, ...]

_LARGEST_KERNEL = 4096


def windows(call: Call, spatial: Shape, kernel: Shape) -> tuple[Indices, Shape]:
    """Return which position each part of the kernel reads at each output position.

    Returns
    -------
    positions : ndarray
        ``(K, P)`` numbers of input positions, -1 in the padding; K parts of the kernel, P output positions.
    shape : tuple of int
        Of the output positions.
    """
    rank = len(spatial)
    strides = call.integers("strides") or (1,) * rank
    dilations = call.integers("dilations") or (1,) * rank
    if call.flag("ceil_mode"):
        raise Refusal("has ceil_mode = 1", "export with ceil_mode=False")
    if not len(kernel) == len(strides) == len(dilations) == rank or min((*kernel, *strides, *dilations)) < 1:
        raise Refusal("has a kernel, strides or dilations that do not fit its input")
    if math.prod(kernel) > _LARGEST_KERNEL:
        raise Refusal(f"has a kernel of {math.prod(kernel)} parts")
    before, after = _padding(call, spatial, kernel, strides, dilations)
    lengths = tuple(
        (spatial[d] + before[d] + after[d] - dilations[d] * (kernel[d] - 1) - 1) // strides[d] + 1
        for d in range(rank)
    )
    if min(lengths) < 1:
        raise Refusal(f"has a kernel {list(kernel)} larger than its input {list(spatial)}")
    call.assembly.reserve(math.prod(kernel), math.prod(lengths))
    places = np.zeros((math.prod(kernel), math.prod(lengths)), dtype=np.int64)
    inside = np.ones(places.shape, dtype=bool)
    offsets = np.array(list(product(*(range(size) for size in kernel)))).reshape(-1, rank)
    outputs = np.indices(lengths).reshape(rank, -1)
    for d in range(rank):
        coordinate = outputs[d] * strides[d] - before[d] + offsets[:, d, None] * dilations[d]
        inside &= (coordinate >= 0) & (coordinate < spatial[d])
        places = places * spatial[d] + coordinate
    return np.where(inside, places, -1), lengths


def _padding(
    call: Call, spatial: Shape, kernel: Shape, strides: Shape, dilations: Shape
) -> tuple[Sequence[int], Sequence[int]]:
    rank, mode = len(spatial), str(call.attributes.get("auto_pad", "NOTSET"))
    if mode == "VALID":
        return (0,) * rank, (0,) * rank
    if mode in ("SAME_UPPER", "SAME_LOWER"):
        needed = [
            max(
                0,
                (-(-spatial[d] // strides[d]) - 1) * strides[d]
                + dilations[d] * (kernel[d] - 1)
                + 1
                - spatial[d],
            )
            for d in range(rank)
        ]
        small, large = [n // 2 for n in needed], [n - n // 2 for n in needed]
        return (small, large) if mode == "SAME_UPPER" else (large, small)
    if mode not in ("", "NOTSET"):
        raise Refusal(f"has auto_pad = '{mode}', which is not known")
    pads = call.integers("pads") or (0,) * (2 * rank)
    if len(pads) != 2 * rank or min(pads) < 0 or max(pads) > 2**16:
        raise Refusal(f"has the padding {list(pads)} for {rank} axes")
    return pads[:rank], pads[rank:]


def _split_shape(x: Computed) -> tuple[int, Shape]:
    if len(x.shape) < 3 or x.shape[0] != 1:
        raise Refusal(f"reads the shape {list(x.shape)}, where one image [1, channels, ...] is expected")
    return x.shape[1], x.shape[2:]


@reads("Conv", 1, 11, 22, treatment="exact")
def read_conv(call: Call) -> Sequence[Value]:
    """Read a convolution of any rank, stride, dilation, padding and number of groups."""
    x, kernel = call.computed(0), counted(call.constant(1, "kernel"), "kernel")
    channels, spatial = _split_shape(x)
    groups = call.integer("group")
    outputs, inputs = kernel.values.shape[:2]
    if groups < 1 or outputs % groups or inputs * groups != channels:
        raise Refusal(f"has a kernel {list(kernel.values.shape)} in {groups} groups for {channels} channels")
    positions, lengths = windows(call, spatial, kernel.values.shape[2:])
    places, area = math.prod(lengths), math.prod(spatial)
    call.assembly.reserve(outputs * places, inputs * len(positions))
    parts, read = np.nonzero(positions >= 0)  # which part of the kernel meets the input at which place
    first_channel = np.arange(outputs) // (outputs // groups) * inputs
    rows = np.arange(outputs)[:, None, None] * places + read  # (M, C, R)
    columns = (first_channel[:, None] + np.arange(inputs))[:, :, None] * area + positions[parts, read]
    rows = np.broadcast_to(rows, columns.shape).ravel()

    def unrolled(taps: Floats) -> Weights:
        values = taps.reshape(outputs, inputs, -1)[:, :, parts]  # (M, C, R)
        return placed(rows, columns.ravel(), values.ravel(), (outputs * places, x.size))

    term = Term(x, unrolled(kernel.values), unrolled(kernel.magnitudes) if kernel.roundings else None)
    none = np.zeros(outputs)
    bias = counted(call.constant(2, "bias"), "bias") if call.has(2) else Counted(none, none)
    offset, magnitude = (np.repeat(numbers, places) for numbers in (bias.values, bias.magnitudes))
    shape, roundings = (1, outputs, *lengths), kernel.roundings + bias.roundings
    return [call.assembly.affine([term], offset, shape, x.precision, roundings, bias_magnitude=magnitude)]


@reads("AveragePool", 7, 10, 11, 19, 22, treatment="exact")
def read_average_pool(call: Call) -> Sequence[Value]:
    """Read a mean over windows, counting the padding or not."""
    x = call.computed(0)
    channels, spatial = _split_shape(x)
    positions, lengths = windows(call, spatial, call.integers("kernel_shape") or ())
    inside = positions >= 0
    counts = np.full(inside.shape[1], len(inside)) if call.flag("count_include_pad") else inside.sum(0)
    if not counts.all():
        raise Refusal("averages over nothing but padding")
    places, area = inside.shape[1], math.prod(spatial)
    call.assembly.reserve(channels * places, x.size)
    one = np.zeros((places, area))
    parts, read = np.nonzero(inside)
    one[read, positions[parts, read]] = 1.0 / counts[read]
    matrix: Floats = np.kron(np.eye(channels), one).astype(np.float64)
    shape = (1, channels, *lengths)
    return [
        call.assembly.affine([Term(x, matrix)], np.zeros(channels * places), shape, x.precision, roundings=1)
    ]


@reads("GlobalAveragePool", 1, 22, treatment="exact")
def read_global_average_pool(call: Call) -> Sequence[Value]:
    """Read a mean over all positions of each channel."""
    x = call.computed(0)
    channels, spatial = _split_shape(x)
    area = math.prod(spatial)
    call.assembly.reserve(channels, x.size)
    matrix = np.kron(np.eye(channels), np.full((1, area), 1.0 / area))
    shape = (1, channels, *(1 for _ in spatial))
    return [call.assembly.affine([Term(x, matrix)], np.zeros(channels), shape, x.precision, roundings=1)]


@reads("MaxPool", 8, 10, 11, 12, 22, treatment="enclosed", note="without indices")
def read_max_pool(call: Call) -> Sequence[Value]:
    """Read a largest value over windows; padding never wins."""
    if call.flag("storage_order"):
        raise Refusal("has storage_order = 1")
    x = call.computed(0)
    channels, spatial = _split_shape(x)
    positions, lengths = windows(call, spatial, call.integers("kernel_shape") or ())
    any_inside = positions.max(axis=0)
    if (any_inside < 0).any():
        raise Refusal("takes a maximum over nothing but padding")
    filled = np.where(positions >= 0, positions, any_inside)  # a repeated value does not change a maximum
    return [_maxima(call, x, filled, (1, channels, *lengths))]


@reads("GlobalMaxPool", 1, 22, treatment="enclosed")
def read_global_max_pool(call: Call) -> Sequence[Value]:
    """Read the largest value of each channel."""
    x = call.computed(0)
    channels, spatial = _split_shape(x)
    positions = np.arange(math.prod(spatial))[:, None]
    return [_maxima(call, x, positions, (1, channels, *(1 for _ in spatial)))]


def _maxima(call: Call, x: Computed, positions: Indices, shape: Shape) -> Computed:
    area = math.prod(x.shape[2:])
    starts = area * np.arange(x.shape[1])
    rows = (starts[None, :, None] + positions[:, None, :]).reshape(len(positions), -1)  # (K, channels * P)
    return tournament(call, x, rows, call.assembly.maximum).reshaped(shape)
