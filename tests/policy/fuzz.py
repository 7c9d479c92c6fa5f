"""Mutated model files: each must load, or be refused by a viatool error, soon and in bounded memory.

A short run belongs to the test suite. A long one, whose figure is in docs/hostile-files.md:

    python -m tests.policy.fuzz --count 200000 --seed 1

Every case is a function of its number, so a failure is repeated with ``--only NUMBER``.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper

from tests.policy.models import node, two_layers
from tests.policy.operator_cases import CASES
from tests.policy.test_exports_shapes import keras, matlab, ml_agents
from viatool.errors import SelfCheckError, ViatoolError
from viatool.policy import load_policy
from viatool.policy.operators import registered

Generator = np.random.Generator
SECONDS = 20
"""Longest time for one file."""
MEGABYTES = 3000
"""Largest growth of the memory of a worker."""


def corpus() -> list[bytes]:
    """Models to start from: actors, every operator in its newest version, a function, external data."""
    models = [two_layers(), keras(), matlab(), ml_agents()]
    newest = onnx.defs.onnx_opset_version()
    for operator in sorted(CASES):
        version = max(v for name, v in registered() if name == operator and v <= newest)
        models += [case.model(max(version, 6)) for case in CASES[operator](version)]
    with_function = two_layers()
    body = [node("Constant", [], ["c"], value_float=0.5), node("Mul", ["v", "c"], ["w"])]
    with_function.functions.append(
        helper.make_function("f", "Half", ["v"], ["w"], body, [helper.make_opsetid("", 17)])
    )
    with_function.opset_import.append(helper.make_opsetid("f", 1))
    with_function.graph.node[0].input[0] = "half"
    with_function.graph.node.insert(0, helper.make_node("Half", ["x"], ["half"], domain="f"))
    outside = two_layers()
    tensor = outside.graph.initializer[0]
    (content,) = (tensor.raw_data,)
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="weights.bin")
    tensor.external_data.add(key="length", value=str(len(content)))
    return [model.SerializeToString() for model in (*models, with_function, outside)]


# --- mutations of bytes ------------------------------------------------------------------------------------


def flip_bits(content: bytes, rng: Generator) -> bytes:
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 8))):
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def set_bytes(content: bytes, rng: Generator) -> bytes:
    changed = bytearray(content)
    start = int(rng.integers(len(changed)))
    for index in range(start, min(len(changed), start + int(rng.integers(1, 9)))):
        changed[index] = int(rng.choice([0x00, 0xFF, 0x7F, 0x80, int(rng.integers(256))]))
    return bytes(changed)


def cut(content: bytes, rng: Generator) -> bytes:
    start, end = sorted(int(i) for i in rng.integers(0, len(content) + 1, 2))
    return content[:start] + content[end:]


def truncate(content: bytes, rng: Generator) -> bytes:
    return content[: int(rng.integers(len(content)))]


def repeat(content: bytes, rng: Generator) -> bytes:
    start, end = sorted(int(i) for i in rng.integers(0, len(content) + 1, 2))
    return content[:end] + content[start:end] + content[end:]


BYTE_MUTATIONS = (flip_bits, set_bytes, cut, truncate, repeat)

# --- mutations of the model --------------------------------------------------------------------------------

ODD_INTEGERS = (-(2**63), -(2**31), -100, -2, -1, 0, 1, 2, 3, 7, 100, 2**20, 2**31, 2**40, 2**63 - 1)
ODD_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-45, 1e38, -1e38, float("inf"), float("-inf"), float("nan"), 0.1)
ODD_NAMES = ("", "x", "y", "x" * 1000, "../x", "\0", "\u202e", "w1")


def odd_integer(rng: Generator) -> int:
    return int(ODD_INTEGERS[int(rng.integers(len(ODD_INTEGERS)))])


def odd_float(rng: Generator) -> float:
    return ODD_FLOATS[int(rng.integers(len(ODD_FLOATS)))]


def value_names(model: onnx.ModelProto) -> list[str]:
    graph = model.graph
    made = [name for call in graph.node for name in (*call.input, *call.output)]
    return [*made, *(t.name for t in graph.initializer), *ODD_NAMES]


def a_node(model: onnx.ModelProto, rng: Generator) -> onnx.NodeProto:
    return model.graph.node[int(rng.integers(len(model.graph.node)))]


def other_operator(model: onnx.ModelProto, rng: Generator) -> None:
    a_node(model, rng).op_type = str(rng.choice([schema.name for schema in SCHEMAS]))


def other_input(model: onnx.ModelProto, rng: Generator) -> None:
    call = a_node(model, rng)
    name = str(rng.choice(value_names(model)))
    if call.input and rng.random() < 0.7:
        call.input[int(rng.integers(len(call.input)))] = name
    else:
        call.input.append(name)


def other_output(model: onnx.ModelProto, rng: Generator) -> None:
    call = a_node(model, rng)
    if call.output:
        call.output[int(rng.integers(len(call.output)))] = str(rng.choice(value_names(model)))


def drop_node(model: onnx.ModelProto, rng: Generator) -> None:
    del model.graph.node[int(rng.integers(len(model.graph.node)))]


def double_node(model: onnx.ModelProto, rng: Generator) -> None:
    copy = onnx.NodeProto()
    copy.CopyFrom(a_node(model, rng))
    if rng.random() < 0.5:
        copy.output[0] = "copied"
    model.graph.node.append(copy)


def insert_node(model: onnx.ModelProto, rng: Generator) -> None:
    """Put an operator without other inputs before or after a node: mostly a valid model."""
    simple = (
        "Relu",
        "Tanh",
        "Neg",
        "Identity",
        "Exp",
        "Abs",
        "Sigmoid",
        "Softmax",
        "Flatten",
        "Transpose",
        "Shape",
    )
    call = a_node(model, rng)
    if not call.input or not call.output:
        return
    old = call.input[0]
    call.input[0] = "inserted"
    index = list(model.graph.node).index(call)
    model.graph.node.insert(index, helper.make_node(str(rng.choice(simple)), [old], ["inserted"]))


def other_attribute(model: onnx.ModelProto, rng: Generator) -> None:
    call = a_node(model, rng)
    known = [a.name for schema in SCHEMAS if schema.name == call.op_type for a in schema.attributes.values()]
    name = str(rng.choice([*known, "axis", "alpha", "surprise"]))
    for index, attribute in enumerate(call.attribute):
        if attribute.name == name:
            del call.attribute[index]
            break
    values: list[Any] = [
        odd_integer(rng), odd_float(rng), [odd_integer(rng) for _ in range(int(rng.integers(5)))], "text", b"\xff",
        [odd_float(rng)], ["a", "b"], helper.make_tensor("t", TensorProto.FLOAT, [1], [odd_float(rng)]),
    ]  # fmt: skip
    value = values[int(rng.integers(len(values)))]
    if value != []:
        call.attribute.append(helper.make_attribute(name, value))


def other_tensor(model: onnx.ModelProto, rng: Generator) -> None:
    if not model.graph.initializer:
        return
    tensor = model.graph.initializer[int(rng.integers(len(model.graph.initializer)))]
    what = int(rng.integers(5))
    if what == 0 and tensor.dims:
        tensor.dims[int(rng.integers(len(tensor.dims)))] = odd_integer(rng)
    elif what == 1:
        tensor.data_type = int(rng.integers(0, 30))
    elif what == 2:
        tensor.dims.append(odd_integer(rng))
    elif what == 3 and tensor.raw_data:
        tensor.raw_data = flip_bits(tensor.raw_data, rng)
    else:
        tensor.name = str(rng.choice(value_names(model)))


def other_numbers(model: onnx.ModelProto, rng: Generator) -> None:
    """Other values in a stored tensor of the same shape: mostly a valid model."""
    inline = [t for t in model.graph.initializer if t.raw_data and t.data_location != TensorProto.EXTERNAL]
    stored = [
        t for t in inline if len(t.raw_data) == 4 * math.prod(t.dims) and t.data_type == TensorProto.FLOAT
    ]
    if not stored:
        return
    tensor = stored[int(rng.integers(len(stored)))]
    array = onnx.numpy_helper.to_array(tensor).copy()
    if array.size:
        position = np.unravel_index(int(rng.integers(array.size)), array.shape)
        odd = odd_float(rng) if array.dtype.kind == "f" else odd_integer(rng)
        with np.errstate(all="ignore"):
            array[position] = np.asarray(odd).astype(array.dtype)
        tensor.CopyFrom(onnx.numpy_helper.from_array(array, tensor.name))


def other_external(model: onnx.ModelProto, rng: Generator) -> None:
    for tensor in model.graph.initializer:
        tensor.data_location = TensorProto.EXTERNAL
        names = ("weights.bin", "/dev/zero", "/etc/passwd", "../weights.bin", "", ".", "none.bin")
        tensor.external_data.add(key="location", value=str(rng.choice(names)))
        tensor.external_data.add(key=str(rng.choice(["offset", "length"])), value=str(odd_integer(rng)))
        if rng.random() < 0.5:
            return


def other_shape(model: onnx.ModelProto, rng: Generator) -> None:
    shape = model.graph.input[0].type.tensor_type.shape
    what = int(rng.integers(4))
    if what == 0 and shape.dim:
        shape.dim[int(rng.integers(len(shape.dim)))].dim_value = odd_integer(rng)
    elif what == 1:
        shape.dim.add().dim_value = int(rng.integers(1, 4))
    elif what == 2 and shape.dim:
        shape.dim[int(rng.integers(len(shape.dim)))].dim_param = "n"
    else:
        model.graph.input[0].type.tensor_type.elem_type = int(rng.integers(0, 30))


def other_opset(model: onnx.ModelProto, rng: Generator) -> None:
    if rng.random() < 0.8:
        model.opset_import[0].version = int(rng.integers(5, 30))
    else:
        model.opset_import[0].domain = str(rng.choice(["ai.onnx", "com.microsoft", "f", ""]))


def other_port(model: onnx.ModelProto, rng: Generator) -> None:
    values = model.graph.input if rng.random() < 0.5 else model.graph.output
    if values:
        values[int(rng.integers(len(values)))].name = str(rng.choice(value_names(model)))


MODEL_MUTATIONS: tuple[Callable[[onnx.ModelProto, Generator], None], ...] = (
    other_operator, other_input, other_output, drop_node, double_node, insert_node, other_attribute, other_tensor,
    other_numbers, other_external, other_shape, other_opset, other_port,
)  # fmt: skip
SCHEMAS = [schema for schema in onnx.defs.get_all_schemas() if schema.domain == ""]


def mutated(content: bytes, number: int, seed: int) -> bytes:
    """Return a mutated model; one to three mutations of its bytes or of its structure."""
    rng = np.random.default_rng((seed, number))
    if rng.random() < 0.4:
        for _ in range(int(rng.integers(1, 3))):
            if content:
                content = BYTE_MUTATIONS[int(rng.integers(len(BYTE_MUTATIONS)))](content, rng)
        return content
    model = onnx.ModelProto()
    model.ParseFromString(content)
    for _ in range(int(rng.integers(1, 4))):
        if model.graph.node:
            MODEL_MUTATIONS[int(rng.integers(len(MODEL_MUTATIONS)))](model, rng)
    return model.SerializeToString()


# --- running -----------------------------------------------------------------------------------------------


class TooSlow(BaseException):
    """One file took longer than `SECONDS`; no `except Exception` may swallow it."""


def outcome_of(content: bytes, folder: Path) -> str:
    """Load one file; return how it ended, or the traceback of what must not happen."""
    path = folder / "policy.onnx"
    path.write_bytes(content)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        policy = load_policy(path)
        policy(np.zeros((2, policy.input_size)))
        ended = "loaded"
    except SelfCheckError as error:
        ended = f"self-check: {error.message}"
    except ViatoolError as error:
        ended = (
            "refused" if error.message and "\n\n" not in error.message else f"bad message: {error.message!r}"
        )
    except TooSlow:
        return f"slow\n{traceback.format_exc()}"
    except BaseException:
        return f"crash\n{traceback.format_exc()}"
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024
    return f"memory grew by {grown:.0f} MB" if grown > MEGABYTES else ended


def run(numbers: range, seed: int) -> Iterator[tuple[int, str]]:
    """Mutate and load files in this process."""

    def give_up(*_: object) -> None:
        raise TooSlow

    seeds = corpus()
    weights = np.random.default_rng(0).normal(size=20).astype(np.float32).tobytes()
    previous = signal.signal(signal.SIGALRM, give_up)
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "weights.bin").write_bytes(weights)
            for number in numbers:
                content = mutated(seeds[number % len(seeds)], number, seed)
                signal.alarm(SECONDS)
                outcome = outcome_of(content, folder)
                signal.alarm(0)
                yield number, outcome
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


def _worker(numbers: range, seed: int, pipe: Any) -> None:
    limit = 8 * 2**30
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for result in run(numbers, seed):
        pipe.send(result)
    pipe.close()


def run_isolated(count: int, seed: int, chunk: int = 2000) -> Iterator[tuple[int, str]]:
    """Load files in child processes, so that a crash of native code is a result and not the end."""
    start = 0
    context = multiprocessing.get_context("spawn")
    while start < count:
        receiver, sender = context.Pipe(duplex=False)
        child = context.Process(target=_worker, args=(range(start, min(start + chunk, count)), seed, sender))
        child.start()
        sender.close()
        last = start - 1
        try:
            while receiver.poll(3 * SECONDS):
                last, outcome = receiver.recv()
                yield last, outcome
            child.kill()
        except EOFError:
            pass
        child.join()
        if child.exitcode:
            kind = "hang" if child.exitcode == -signal.SIGKILL else "crash"
            yield last + 1, f"{kind}\nthe process ended with code {child.exitcode}"
            start = last + 2
        else:
            start += chunk


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="run one case in this process and show how it ends")
    options = parser.parse_args()
    if options.only is not None:
        for _, outcome in run(range(options.only, options.only + 1), options.seed):
            print(outcome)
        return 0
    tally: Counter[str] = Counter()
    began = time.perf_counter()
    for number, outcome in run_isolated(options.count, options.seed):
        kind = outcome.partition("\n")[0].partition(":")[0]
        tally[kind] += 1
        if kind not in ("loaded", "refused"):
            print(f"case {number}: {outcome}", flush=True)
        if (number + 1) % 10_000 == 0:
            print(number + 1, dict(tally), f"{time.perf_counter() - began:.0f} s", flush=True)
    print(f"{options.count} files, seed {options.seed}: {dict(tally)}, {time.perf_counter() - began:.0f} s")
    return 0 if set(tally) <= {"loaded", "refused", "self-check"} else 1


if __name__ == "__main__":
    sys.exit(main())
