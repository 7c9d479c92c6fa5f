"""Mutated model files: each must load and agree with onnxruntime, or be refused by a viatool error, soon and in
bounded memory.

A short run belongs to the test suite. A long one, whose figures are in docs/results/fuzz.md:

    python -m tests.policy.fuzz --count 200000 --seed 1 --corpus FOLDER

Every case is a function of its number, the seed and the corpus, so a failure is repeated with ``--only NUMBER``.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
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
from tests.policy.test_exports_shapes import isaac_lab, keras, matlab, ml_agents
from viatool.errors import SelfCheckError, ViatoolError
from viatool.policy import load_policy
from viatool.policy.executed import executed_networks
from viatool.policy.model_file import open_model
from viatool.policy.operators import registered
from viatool.policy.self_check import check_executed

Generator = np.random.Generator
MEMORY = Path("/dev/shm")
"""Where files cost no disk, on Linux."""
SECONDS = 5.0
"""Longest processor time for one file."""
START_SECONDS, HANG_SECONDS = 900, 300
"""Longest wait for the first file of a worker, which imports everything, and for each other file."""
MEGABYTES = 1000
"""Largest growth of the memory of a worker by a few files."""
_CHECKED = 20
"""Files between two looks at the memory: asking costs as much as reading a small file."""


def corpus(folder: Path | None = None) -> list[bytes]:
    """Models to start from: actors, every operator in its oldest and newest version, a function, external data.

    Parameters
    ----------
    folder : Path, optional
        Its ``.onnx`` files stand first.
    """
    exports = [] if folder is None else [path.read_bytes() for path in sorted(folder.glob("*.onnx"))]
    models = [two_layers(), keras(), matlab(), ml_agents(), isaac_lab()]
    newest = onnx.defs.onnx_opset_version()
    for operator in sorted(CASES):
        versions = [v for name, v in registered() if name == operator and v <= newest]
        for version in sorted({min(versions), max(versions)}):
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
    return [*exports, *(model.SerializeToString() for model in (*models, with_function, outside))]


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


def swap_inputs(model: onnx.ModelProto, rng: Generator) -> None:
    """Exchange two operands of a call: mostly a valid model with another meaning."""
    call = a_node(model, rng)
    if len(call.input) > 1:
        first, second = (int(i) for i in rng.choice(len(call.input), 2, replace=False))
        call.input[first], call.input[second] = call.input[second], call.input[first]


def similar_operator(model: onnx.ModelProto, rng: Generator) -> None:
    """Call an operator with the same numbers of inputs and outputs: often a valid model."""
    call = a_node(model, rng)
    counts = (len(call.input), len(call.output))
    fitting = [
        schema.name
        for schema in SCHEMAS
        if schema.min_input <= counts[0] <= schema.max_input
        and schema.min_output <= counts[1] <= schema.max_output
    ]
    call.op_type = str(rng.choice(fitting or [call.op_type]))
    known = next((s.attributes for s in SCHEMAS if s.name == call.op_type), {})
    for index in reversed(range(len(call.attribute))):
        if call.attribute[index].name not in known:
            del call.attribute[index]


def nudge_attribute(model: onnx.ModelProto, rng: Generator) -> None:
    """Change an attribute that is there by a little."""
    call = a_node(model, rng)
    if not call.attribute:
        return
    attribute = call.attribute[int(rng.integers(len(call.attribute)))]
    if attribute.type == onnx.AttributeProto.INT:
        attribute.i = min(max(attribute.i + int(rng.integers(-2, 3)), -(2**62)), 2**62)
    elif attribute.type == onnx.AttributeProto.FLOAT:
        attribute.f *= float(rng.choice([-1.0, 0.0, 0.5, 2.0]))
    elif attribute.ints:
        position = int(rng.integers(len(attribute.ints)))
        attribute.ints[position] = min(max(attribute.ints[position] + int(rng.integers(-1, 2)), -9), 2**40)


def close_a_cycle(model: onnx.ModelProto, rng: Generator) -> None:
    """Let a node read what is made from its own output."""
    nodes = model.graph.node
    earlier, later = sorted(int(i) for i in rng.integers(len(nodes), size=2))
    if nodes[earlier].input and nodes[later].output:
        nodes[earlier].input[0] = nodes[later].output[0]


def change_function(model: onnx.ModelProto, rng: Generator) -> None:
    """Damage a model-local function, or wrap a node into a call of one."""
    if not model.functions:
        function = model.functions.add(name="F", domain="f", input=["v"], output=["w"])
        function.opset_import.add(domain="", version=int(rng.integers(5, 30)))
        function.opset_import.add(domain="f", version=1)
        function.node.add(op_type=str(rng.choice(["Relu", "F", "Tanh", "LSTM"])), input=["v"], output=["w"])
        function.node[0].domain = "f" if function.node[0].op_type == "F" else ""
        model.opset_import.add(domain="f", version=1)
        call = a_node(model, rng)
        if len(call.input) == len(call.output) == 1:
            call.op_type, call.domain = "F", "f"
        return
    function = model.functions[0]
    what = int(rng.integers(4))
    if what == 0:
        function.output.append(str(rng.choice(["v", "w", "nowhere"])))
    elif what == 1 and function.node:
        function.node[0].op_type = str(rng.choice([schema.name for schema in SCHEMAS]))
    elif what == 2:
        function.input.append("more")
    else:
        model.functions.add().CopyFrom(function)


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
        names = (
            "weights.bin", "/dev/zero", "/etc/passwd", "../weights.bin", "", ".", "none.bin", "link.bin", "loop.bin",
            "inner/../weights.bin", "C:\\weights.bin", "pipe.bin", "x" * 5000, "weights.bin/",
        )  # fmt: skip
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
    other_numbers, other_external, other_shape, other_opset, other_port, swap_inputs, similar_operator,
    nudge_attribute, close_a_cycle, change_function, swap_inputs, similar_operator, nudge_attribute, other_numbers,
    insert_node,
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
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        if model.graph.node:
            MODEL_MUTATIONS[int(rng.integers(len(MODEL_MUTATIONS)))](model, rng)
    return model.SerializeToString()


# --- running -----------------------------------------------------------------------------------------------


class TooSlow(BaseException):
    """One file took longer than `SECONDS`; no `except Exception` may swallow it."""


def outcome_of(content: bytes, folder: Path, seed: int = 1) -> str:
    """Load one file; return how it ended, or the traceback of what must not happen.

    What loads has passed the self-check; it is compared with onnxruntime again, on other observations.
    """
    path = folder / "policy.onnx"
    path.write_bytes(content)
    try:
        policy = load_policy(path)
        executed = executed_networks(open_model(path), policy.network, policy.runtime)
        check_executed(executed, policy.runtime, None, seed=seed + 1)
        ended = "loaded"
    except SelfCheckError as error:
        # the program itself gives no number, for example 0 * inf with a stored 1e38: refused before any verdict
        ended = "no number" if "against nan" in error.message else f"self-check: {error.message}"
    except ViatoolError as error:
        ended = (
            "refused" if error.message and "\n\n" not in error.message else f"bad message: {error.message!r}"
        )
    except TooSlow:
        return f"slow\n{traceback.format_exc()}"
    except MemoryError:
        return f"memory\n{traceback.format_exc()}"
    except BaseException:
        return f"crash\n{traceback.format_exc()}"
    return ended


def run(numbers: range, seed: int, seeds: list[bytes] | None = None) -> Iterator[tuple[int, str]]:
    """Mutate and load files in this process."""

    def give_up(*_: object) -> None:
        raise TooSlow

    seeds = corpus() if seeds is None else seeds
    previous = signal.signal(signal.SIGPROF, give_up)
    try:
        with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as name:
            folder = Path(name)
            _lay_out(folder)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            for number in numbers:
                content = mutated(seeds[number % len(seeds)], number, seed)
                signal.setitimer(signal.ITIMER_PROF, SECONDS)
                outcome = outcome_of(content, folder, number)
                signal.setitimer(signal.ITIMER_PROF, 0)
                if number % _CHECKED == 0:
                    memory, before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, memory
                    if memory - before > 1024 * MEGABYTES:
                        outcome = (
                            f"memory grew by {(memory - before) / 1024:.0f} MB since {number - _CHECKED}"
                        )
                yield number, outcome
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, previous)


def _lay_out(folder: Path) -> None:
    """Put beside the model what external data may name: weights, links, a pipe, a folder."""
    weights = np.random.default_rng(0).normal(size=20).astype(np.float32).tobytes()
    (folder / "weights.bin").write_bytes(weights)
    (folder / "link.bin").symlink_to("/etc/hostname")
    (folder / "loop.bin").symlink_to("loop.bin")
    (folder / "inner").mkdir()
    os.mkfifo(folder / "pipe.bin")


def _worker(numbers: range, seed: int, folder: Path | None, pipe: Any) -> None:
    limit = 8 * 2**30
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for result in run(numbers, seed, corpus(folder)):
        pipe.send(result)
    pipe.close()


def run_isolated(
    count: int, seed: int, folder: Path | None = None, chunk: int = 5000
) -> Iterator[tuple[int, str]]:
    """Load files in child processes, so that a crash of native code is a result and not the end."""
    start = 0
    context = multiprocessing.get_context("spawn")
    while start < count:
        receiver, sender = context.Pipe(duplex=False)
        child = context.Process(
            target=_worker, args=(range(start, min(start + chunk, count)), seed, folder, sender)
        )
        child.start()
        sender.close()
        last = start - 1
        try:
            while receiver.poll(START_SECONDS if last < start else HANG_SECONDS):
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
    parser.add_argument("--corpus", type=Path, help="a folder with more models to start from")
    parser.add_argument("--only", type=int, help="run one case in this process and show how it ends")
    options = parser.parse_args()
    if options.only is not None:
        for _, outcome in run(range(options.only, options.only + 1), options.seed, corpus(options.corpus)):
            print(outcome)
        return 0
    tally: Counter[str] = Counter()
    began = time.perf_counter()
    for number, outcome in run_isolated(options.count, options.seed, options.corpus):
        kind = outcome.partition("\n")[0].partition(":")[0]
        tally[kind] += 1
        if kind not in ("loaded", "refused"):
            print(f"case {number}: {outcome}", flush=True)
        if (number + 1) % 5_000 == 0:
            print(number + 1, dict(tally), f"{time.perf_counter() - began:.0f} s", flush=True)
    print(f"{options.count} files, seed {options.seed}: {dict(tally)}, {time.perf_counter() - began:.0f} s")
    return 0 if set(tally) <= {"loaded", "refused", "no number"} else 1


if __name__ == "__main__":
    sys.exit(main())
