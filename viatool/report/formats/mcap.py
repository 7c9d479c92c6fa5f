"""What was found as a recording of ROS 2 messages, which Foxglove and RViz play beside that of the robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.report.document import Playable
from viatool.report.sections import Check

if TYPE_CHECKING:
    from rosbags.interfaces import Qos
    from rosbags.typesys.store import Typestore

    from viatool.report.playback.messages import RosMessage

SUFFIXES = (".mcap",)
NEEDS = Playable
LIBRARIES = ("rosbags",)
_PART = 2**20  # bytes that are in memory at the same time
_VERSION = 8  # of the metadata: ROS 2 from Humble on reads it
_NESTED, _REPEATED = 2, (3, 4)  # kinds of fields in rosbags
_ARRAYS = {"int8": np.int8, "float32": np.float32}  # what is left empty


def render(document: Playable, checks: Sequence[Check], suffix: str) -> Iterator[bytes]:
    """Yield the recording part by part; rosbags writes it into a temporary folder."""
    with TemporaryDirectory() as folder:
        written = _write(Path(folder) / "viatool", document.play())
        with written.open("rb") as stream:
            while part := stream.read(_PART):
                yield part


def _write(folder: Path, messages: Iterable[RosMessage]) -> Path:
    """Write messages, some at a time, and return the file."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(folder, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with writer:
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic,
                    message.type,
                    typestore=store,
                    offered_qos_profiles=[_service(lasting=message.lasting)],
                )
            made = _made(store, message.type, message.fields)
            writer.write(connections[message.topic], message.stamp, store.serialize_cdr(made, message.type))
    return next(folder.glob("*.mcap"))


def _made(store: Typestore, name: str, fields: Mapping[str, Any]) -> Any:
    """Make a message of a type; what is not given is 0, or empty."""
    parts = []
    for field, (kind, detail) in store.fielddefs[name][1]:
        if kind == _NESTED:
            parts.append(_made(store, detail, fields.get(field, {})))
        elif kind in _REPEATED:
            of_kind, item = detail[0]
            given = fields.get(field, ())
            if of_kind == _NESTED:
                parts.append([_made(store, item, one) for one in given])
            else:
                parts.append(np.asarray(given, _ARRAYS.get(item[0], np.uint8)))
        else:
            parts.append(fields.get(field, "" if detail[0] == "string" else 0))
    return store.types[name](*parts)


def _service(*, lasting: bool) -> Qos:
    """Return how a topic is to be published again: reliably, and to late listeners too where it lasts."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(9223372036, 854775807)  # as ROS 2 writes infinity
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if lasting else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if lasting else QosDurability.VOLATILE,
        deadline=never,
        lifespan=never,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )
